"""Optimal control of systems that switch and jump, as complementarity problems.

``python -m tests.benchmarks.mpcc.switching [WORD ...]`` solves them, also by a plain Scholtes loop.

Finite elements have free lengths, so that switches fall between two (Nurkanovic, Sperl, Albrecht
and Diehl 2024; with jumps, Nurkanovic, Frey, Pozharskiy and Diehl 2024): within an element a switch
stays on one side, which is a complementarity of sums over the element's stages.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from ocp.mpcc import MPCC, solve
from tests.benchmarks.mpcc import scholtes_peer
from tests.benchmarks.mpcc.bench import residuals

LONGEST, SHORTEST, EVEN = 2.0, 0.1, 1e-2
"""Bounds of an element's length over the mean, and the weight of squared differences from the mean."""


@dataclass
class Rows:
    """Variables with their bounds and initial guess, equations, inequalities, and pairs."""

    x: list[ca.SX] = field(default_factory=list)
    bounds: list[tuple[float, float]] = field(default_factory=list)
    start: list[float] = field(default_factory=list)
    g: list[ca.SX] = field(default_factory=list)
    upper: list[float] = field(default_factory=list)
    sides: list[tuple[ca.SX, ca.SX]] = field(default_factory=list)
    f: ca.SX = field(default_factory=lambda: ca.SX(0))

    def new(
        self,
        name: str,
        n: int,
        low: float = -np.inf,
        high: float = np.inf,
        start: float | np.ndarray = 0.0,
    ) -> ca.SX:
        """Add variables (n,), and return them."""
        symbol = ca.SX.sym(f"{name}_{len(self.x)}", n)
        self.x.append(symbol)
        self.bounds += n * [(low, high)]
        self.start += [float(v) for v in np.broadcast_to(start, n)]
        return symbol

    def zero(self, row: ca.SX) -> None:
        """Add the constraint ``row = 0``."""
        self.g.append(row)
        self.upper += row.numel() * [0.0]

    def positive(self, row: ca.SX) -> None:
        """Add the constraint ``row >= 0``."""
        self.g.append(row)
        self.upper += row.numel() * [np.inf]

    def pairs(self, first: ca.SX, second: ca.SX) -> None:
        """Add the constraint ``0 <= first ⟂ second >= 0``, entry by entry."""
        self.sides.append((first, second))

    def made(self, name: str) -> tuple[MPCC, np.ndarray]:
        """Return the problem and its initial guess."""
        lower, upper = np.array(self.bounds).T
        G, H = (ca.vertcat(*sides) for sides in zip(*self.sides, strict=True))
        g = ca.vertcat(*self.g)
        problem = MPCC(ca.vertcat(*self.x), self.f, G, H, g, lbx=lower, ubx=upper, lbg=0.0, ubg=self.upper, name=name)
        return problem, np.array(self.start)


@dataclass(frozen=True)
class Mesh:
    """Stages of constant input, elements in each, and collocation points in an element."""

    stages: int
    elements: int
    points: int = 2
    scheme: str = "radau"
    duration: float = 1.0
    fine: bool = False
    """Whether there is a pair for every collocation point, instead of one per element."""
    direct: bool = False
    """Whether equations allow elements to differ in length only where something switches."""

    @property
    def mean(self) -> float:
        """Mean length of an element."""
        return self.duration / (self.stages * self.elements)

    @property
    def table(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Coefficients of derivatives at collocation points (d+1, d), ends (d+1,), and weights (d+1,)."""
        C, D, B = ca.collocation_coeff(ca.collocation_points(self.points, self.scheme))
        return np.array(C), np.array(D).ravel(), np.array(B).ravel()


def lengths(rows: Rows, mesh: Mesh) -> list[ca.SX]:
    """Add and return the free lengths of one stage's elements, which sum to the stage's length."""
    own = [rows.new("h", 1, SHORTEST * mesh.mean, LONGEST * mesh.mean, mesh.mean) for _ in range(mesh.elements)]
    rows.zero(ca.sum1(ca.vertcat(*own)) - mesh.elements * mesh.mean)
    for h in own:
        rows.f += EVEN * ((h - mesh.mean) / mesh.mean) ** 2
    return own


def element(
    rows: Rows,
    mesh: Mesh,
    h: ca.SX,
    x: ca.SX,
    start: np.ndarray,
    at: Callable[[ca.SX], tuple[ca.SX, ca.SX]],
) -> ca.SX:
    """Collocate one element from x; return its end. ``at`` gives rate and running cost at a point."""
    C, D, B = mesh.table
    own = [rows.new("x", x.numel(), start=start) for _ in range(mesh.points)]
    states = ca.horzcat(x, *own)
    for j, state in enumerate(own):
        rate, cost = at(state)
        rows.zero(ca.mtimes(states, ca.DM(C[:, j])) - h * rate)
        rows.f += h * float(B[j]) * cost
    if mesh.scheme == "radau":
        return own[-1]
    end = rows.new("x", x.numel(), start=start)
    rows.zero(end - ca.mtimes(states, ca.DM(D)))
    return end


@dataclass(frozen=True)
class Switched:
    """System ``x' = rate(x, u, alpha)``, alpha_i = 1 if ``switches_i(x) > 0``, 0 if < 0, between at 0.

    ``at_end`` vanishes at the end; ``cost`` is a running cost.
    """

    x0: np.ndarray
    inputs: int
    low: float
    high: float
    rate: Callable[[ca.SX, ca.SX, ca.SX], ca.SX]
    switches: Callable[[ca.SX], ca.SX]
    cost: Callable[[ca.SX, ca.SX], ca.SX]
    at_end: Callable[[ca.SX], ca.SX]


def switched(name: str, system: Switched, mesh: Mesh) -> tuple[MPCC, np.ndarray]:
    """Return the problem of a system that switches, and its initial guess."""
    rows, x0 = Rows(), system.x0
    k = system.switches(ca.SX(x0)).numel()
    x, before = ca.SX(x0), ca.SX(2 * k, 1)
    last: tuple[ca.SX, ...] = ()
    for _ in range(mesh.stages):
        u = rows.new("u", system.inputs, system.low, system.high)
        for h in lengths(rows, mesh):
            alphas: list[ca.SX] = []
            distances: list[ca.SX] = []

            def split(state: ca.SX, distances: list[ca.SX] = distances) -> None:
                sides = rows.new("side", 2 * k, 0.0, start=0.5)
                rows.zero(system.switches(state) - sides[:k] + sides[k:])
                distances.append(sides)

            def at(
                state: ca.SX,
                u: ca.SX = u,
                alphas: list[ca.SX] = alphas,
                split: Callable[[ca.SX], None] = split,
            ) -> tuple[ca.SX, ca.SX]:
                alpha = rows.new("alpha", k, 0.0, 1.0, 0.5)
                alphas.append(ca.vertcat(1 - alpha, alpha))
                split(state)
                return system.rate(state, u, alpha), system.cost(state, u)

            x = element(rows, mesh, h, x, x0, at)
            if mesh.scheme != "radau":
                split(x)
            away = sum(distances, before)
            share = sum(alphas[1:], alphas[0])
            for one in alphas if mesh.fine else [share]:
                rows.pairs(one, away)
            if mesh.direct and last:
                rows.zero(_still(last[0], share, last[1], away) * (h - last[2]))
            last, before = (share, away, h), distances[-1]
        last = ()
    rows.zero(system.at_end(x))
    return rows.made(name)


def _still(share0: ca.SX, share1: ca.SX, away0: ca.SX, away1: ca.SX) -> ca.SX:
    """Return an expression that is positive if no switch changes side between two elements."""
    k = share0.numel() // 2
    same = share0 * share1 + away0 * away1
    return math.prod(ca.vertsplit(same[:k] + same[k:]), start=ca.SX(1))


@dataclass(frozen=True)
class Jumping:
    """System ``q'' = force(q, v, u) + J^T lam`` over a floor, with jumps ``v+ = -e v-``.

    ``gap`` is the height of the first coordinate; ``at_end`` vanishes at the end.
    """

    q0: np.ndarray
    elasticity: float
    inputs: int
    low: float
    high: float
    force: Callable[[ca.SX, ca.SX, ca.SX], ca.SX]
    cost: Callable[[ca.SX, ca.SX], ca.SX]
    at_end: Callable[[ca.SX], ca.SX]


def jumping(name: str, system: Jumping, mesh: Mesh) -> tuple[MPCC, np.ndarray]:
    """Return the problem of a system that jumps, and its initial guess."""
    rows, n = Rows(), system.q0.size
    start = np.concatenate([system.q0, np.zeros(n)])
    x = ca.SX(start)
    normal = ca.SX(np.eye(n)[:, 0])
    for _ in range(mesh.stages):
        u = rows.new("u", system.inputs, system.low, system.high)
        for h in lengths(rows, mesh):
            forces: list[ca.SX] = []
            gaps: list[ca.SX] = []

            def at(
                state: ca.SX, u: ca.SX = u, forces: list[ca.SX] = forces, gaps: list[ca.SX] = gaps
            ) -> tuple[ca.SX, ca.SX]:
                lam = rows.new("lam", 1, 0.0)
                forces.append(lam)
                gaps.append(state[0])
                rows.positive(state[0])
                q, v = state[:n], state[n:]
                return ca.vertcat(v, system.force(q, v, u) + normal * lam), system.cost(state, u)

            begin = x[0]
            end = element(rows, mesh, h, x, start, at)
            if mesh.scheme != "radau":
                gaps.append(end[0])
                rows.positive(end[0])
            away = sum(gaps, begin)
            for one in forces if mesh.fine else [sum(forces[1:], forces[0])]:
                rows.pairs(one, away)
            x = jumped(rows, system, end, start)
    rows.zero(system.at_end(x))
    return rows.made(name)


def jumped(rows: Rows, system: Jumping, end: ca.SX, start: np.ndarray) -> ca.SX:
    """Return the state after the jump that follows an element."""
    n = system.q0.size
    kick, sides = rows.new("kick", 1, 0.0), rows.new("lift", 2, 0.0)
    after = rows.new("v", n, start=start[n:])
    rows.zero(after - end[n:] - ca.SX(np.eye(n)[:, 0]) * kick)
    rows.zero(after[0] + system.elasticity * end[n] - sides[0] + sides[1])
    rows.pairs(kick, end[0])
    rows.pairs(kick, sides[0] + sides[1])
    return ca.vertcat(end[:n], after)


def tanks(count: int, mesh: Mesh) -> tuple[MPCC, np.ndarray]:
    """Return a cascade of tanks whose valves open at a level, filled by one pump to given levels."""
    levels = np.linspace(0.8, 0.5, count)

    def rate(x: ca.SX, u: ca.SX, alpha: ca.SX) -> ca.SX:
        out = 0.5 * x + 2.0 * alpha * (0.2 + x)
        return ca.vertcat(u, *ca.vertsplit(out)[:-1]) - out

    return switched(
        f"tank-{count}",
        Switched(
            np.full(count, 0.2),
            1,
            0.0,
            5.0,
            rate,
            switches=lambda x: x - levels,
            cost=lambda x, u: 0.1 * ca.sumsqr(u) + ca.sumsqr(x - 0.6),
            at_end=lambda x: x[-1] - 0.55,
        ),
        mesh,
    )


def carriers(count: int, mesh: Mesh) -> tuple[MPCC, np.ndarray]:
    """Return carriers on a rail, coupled by springs; the first is driven, all have friction brakes."""

    def rate(x: ca.SX, u: ca.SX, alpha: ca.SX) -> ca.SX:
        q, v = x[:count], x[count:]
        force = -(0.3 + u[1]) * (2 * alpha - 1)
        drive = ca.vertcat(u[0] - 1, ca.SX(count - 1, 1))
        stretch = q[1:] - q[:-1]
        pull = ca.vertcat(stretch, 0) - ca.vertcat(0, stretch) if count > 1 else 0
        return ca.vertcat(v, force + drive * 4 + 20 * pull)

    return switched(
        f"carrier-{count}",
        Switched(
            np.zeros(2 * count),
            2,
            0.0,
            2.0,
            rate,
            switches=lambda x: x[count:],
            cost=lambda x, u: 0.1 * ca.sumsqr(u[0] - 1) + 0.05 * u[1] ** 2 + ca.sumsqr(x[0] - 1),
            at_end=lambda x: ca.vertcat(x[0] - 1, x[count:]),
        ),
        mesh,
    )


def hopper(elasticity: float, mesh: Mesh) -> tuple[MPCC, np.ndarray]:
    """Return a ball with thrusters that bounces to a given position."""
    return jumping(
        "bouncer",
        Jumping(
            np.array([1.0, 0.0]),
            elasticity,
            2,
            -12.0,
            12.0,
            force=lambda q, v, u: u - ca.DM([9.81, 0.0]),
            cost=lambda x, u: 0.01 * ca.sumsqr(u),
            at_end=lambda x: x - ca.DM([0.5, 2.0, 0.0, 0.0]),
        ),
        mesh,
    )


def instances() -> dict[str, Callable[[], tuple[MPCC, np.ndarray]]]:
    """Return every instance by name."""
    found: dict[str, Callable[[], tuple[MPCC, np.ndarray]]] = {}
    kinds: dict[str, Callable[[Mesh], tuple[MPCC, np.ndarray]]] = {
        "tank-1": lambda mesh: tanks(1, mesh),
        "tank-3": lambda mesh: tanks(3, mesh),
        "carrier-1": lambda mesh: carriers(1, mesh),
        "carrier-3": lambda mesh: carriers(3, mesh),
        "hopper": lambda mesh: hopper(0.8, mesh),
        "hopper-plastic": lambda mesh: hopper(0.0, mesh),
    }
    for kind, make in kinds.items():
        for scheme in ("radau", "legendre"):
            for stages, elements, points, fine, direct in (
                (5, 2, 3, False, False),
                (10, 3, 2, False, False),
                (10, 3, 2, True, False),
                (25, 2, 3, True, False),
                (10, 3, 2, False, True),
            ):
                if direct and "hopper" in kind:
                    continue
                length = 2.0 if "carrier" in kind or "hopper" in kind else 3.0
                mesh = Mesh(stages, elements, points, scheme, length, fine, direct)
                label = f"{kind} {scheme} {stages}x{elements}x{points}"
                label += " fine" * fine + " direct" * direct
                found[label] = lambda make=make, mesh=mesh: make(mesh)
    return found


def measured(name: str, ours: bool) -> str:
    """Solve one instance, or by the plain loop; return cost, violation, complementarity, seconds as text."""
    problem, start = instances()[name]()
    began = time.perf_counter()
    if ours:
        found = solve(problem, start)
        x, f, note = found.x, found.f, found.certificate.stationarity if found.success else "none"
    else:
        loop = scholtes_peer.solve(problem, start)
        x, f, note = loop.x, loop.f, "converged" if loop.converged else "not converged"
    seconds = time.perf_counter() - began
    worst, apart, _ = residuals(problem, x)
    return f"{f:>10.6g}{worst:>9.0e}{apart:>9.0e}{seconds:>8.1f}  {note:<14}"


def main(words: list[str]) -> None:
    """Print a line for each instance whose name has one of the words: the solver, then the loop."""
    head = f"{'cost':>10}{'off':>9}{'min':>9}{'s':>8}  {'':<14}"
    print(f"{'instance':<32}{'n':>6}{'pairs':>6}{head}{head}")
    for name, make in instances().items():
        if words and not any(word in name for word in words):
            continue
        problem, _ = make()
        sizes = f"{problem.x.numel():>6}{problem.G.numel():>6}"
        print(f"{name:<32}{sizes}{measured(name, True)}{measured(name, False)}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
