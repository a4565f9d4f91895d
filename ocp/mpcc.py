"""Complementarity problems of anyone, in CasADi: stated as expressions, solved and certified.

The follower of a bilevel problem chooses y to minimise ``(y - x)²`` subject to ``y <= p``; with the
multiplier s of that bound its optimality is ``y - x + s = 0``, ``0 <= s ⟂ p - y >= 0``. The leader
chooses x::

    import casadi as ca
    from ocp.mpcc import MPCC, solve

    x, y, s, p = (ca.SX.sym(name) for name in "xysp")
    problem = MPCC(
        x=ca.vertcat(x, y, s),
        p=p,
        f=(x - 2) ** 2 + (y - 3) ** 2,
        g=y - x + s,
        G=s,
        H=p - y,
        names=["follower's bound"],
    )
    solution = solve(problem, x0=[0.0, 0.0, 0.0], p=[1.0])
    print(solution.verdict)
    print(solution.x, solution.f, solution.certificate.stationarity)
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from ocp.audit import TOLERANCES
from ocp.certificate import Certificate, certify
from ocp.errors import InputError
from ocp.mpcc_program import MPCCProgram, Programs
from ocp.problem import Reference
from ocp.program import Program
from ocp.routes.complementarity import Route, solve_pairs
from ocp.routes.legs import Homotopy
from ocp.routes.relaxations import STRATEGIES
from ocp.routes.restoration import violation
from ocp.solution import Status
from ocp.solver import Point, Result, Solver

DEFAULTS = ("l1-quick", "scholtes-quick")
"""Strategies that are tried: an exact penalty is cheapest, the relaxation bears more."""
_LARGE = 1000
"""Variables from which on the first certified answer is taken."""


@dataclass(frozen=True, eq=False)
class MPCC:
    """``min f(x, p)`` subject to ``lbg <= g(x, p) <= ubg``, ``lbx <= x <= ubx`` and
    ``0 <= G(x, p) ⟂ H(x, p) >= 0``.

    x (n, 1), p (n_p, 1) are symbols, f (1, 1), g (m, 1), G and H (k, 1) expressions in them. Bounds
    are numbers or sequences; without ``lbg``, ``ubg`` g is an equation. ``names`` (k) name the
    pairs in verdicts.

    Raises :class:`~ocp.errors.InputError` where sizes do not fit, bounds cross, a symbol is not
    declared, or a pair is the same expression twice.
    """

    x: ca.SX
    f: ca.SX
    G: ca.SX
    H: ca.SX
    g: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    p: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    lbx: float | Sequence[float] | np.ndarray = -np.inf
    ubx: float | Sequence[float] | np.ndarray = np.inf
    lbg: float | Sequence[float] | np.ndarray = 0.0
    ubg: float | Sequence[float] | np.ndarray = 0.0
    names: Sequence[str] = ()
    name: str = "mpcc"

    def __post_init__(self) -> None:
        for what, value in (("f", self.f), ("g", self.g), ("G", self.G), ("H", self.H)):
            object.__setattr__(self, what, ca.densify(ca.SX(value)))
        self._check_sizes()
        for what, lower, upper in (("x", *self.x_bounds), ("g", *self.g_bounds)):
            crossed = np.flatnonzero(~(lower <= upper))
            if crossed.size:
                i = int(crossed[0])
                raise InputError(
                    f"{self.name}: the bounds of {what}[{i}] cross: {lower[i]:g} > {upper[i]:g};"
                    " exchange or widen them"
                )
        for i in range(self.G.numel()):
            if ca.is_equal(self.G[i], self.H[i], 2):
                raise InputError(
                    f"{self.name}: pair {self.pair(i)!r} is the same expression twice,"
                    f" {self.G[i]}; a pair needs two sides"
                )

    def _check_sizes(self) -> None:
        if self.f.numel() != 1:
            raise InputError(f"{self.name}: f has {self.f.numel()} entries, expected 1")
        if self.G.numel() != self.H.numel():
            raise InputError(
                f"{self.name}: G has {self.G.numel()} entries and H {self.H.numel()}; expected as"
                " many of both"
            )
        if self.names and len(self.names) != self.G.numel():
            raise InputError(
                f"{self.name}: {len(self.names)} names for {self.G.numel()} pairs; give one each"
            )
        known = {str(symbol) for symbol in ca.symvar(ca.vertcat(self.x, self.p))}
        used = ca.symvar(ca.vertcat(self.f, self.g, self.G, self.H))
        strange = sorted({str(symbol) for symbol in used} - known)
        if strange:
            raise InputError(f"{self.name}: {', '.join(strange)} is neither in x nor in p")

    def pair(self, index: int) -> str:
        """Name of a pair."""
        return self.names[index] if self.names else f"pair {index}"

    @property
    def x_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of x, (n,) each."""
        n = self.x.numel()
        return _sized(self.name, "lbx", self.lbx, n), _sized(self.name, "ubx", self.ubx, n)

    @property
    def g_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of g, (m,) each."""
        m = self.g.numel()
        return _sized(self.name, "lbg", self.lbg, m), _sized(self.name, "ubg", self.ubg, m)


def _sized(name: str, what: str, value: float | Sequence[float] | np.ndarray, n: int) -> np.ndarray:
    numbers = np.asarray(value, dtype=float).ravel()
    if numbers.size not in (1, n):
        raise InputError(f"{name}: {what} has {numbers.size} entries, expected {n}")
    return np.broadcast_to(numbers, n).copy()


@dataclass(frozen=True)
class MPCCSolution:
    """An answer to an :class:`MPCC`: x (n,), G and H (k,) there, cost and certificate.

    ``success`` means feasible to 1e-6 and certified B-stationary, whatever a solver said.
    ``infeasibility`` is the largest violation of a bound, of g, or of min(G, H) = 0; ``worst`` says
    where. ``strategy`` is the one that led there.
    """

    x: np.ndarray
    G: np.ndarray
    H: np.ndarray
    f: float
    status: Status
    certificate: Certificate
    infeasibility: float
    worst: str
    strategy: str
    iterations: int
    seconds: float

    @property
    def success(self) -> bool:
        """Whether the answer is certified."""
        return self.status is Status.SOLVED

    @property
    def verdict(self) -> str:
        """What was found, in a sentence or two."""
        if self.status is Status.INFEASIBLE:
            return f"Locally infeasible: {self.worst} cannot be met near the last point."
        word = self.status.value.partition(":")[0].capitalize()
        return f"{word}: cost {self.f:.8g}; {self.certificate.sentence}."


def solve(
    mpcc: MPCC,
    x0: float | Sequence[float] | np.ndarray = 0.0,
    p: Sequence[float] | np.ndarray = (),
    strategies: Sequence[str] = DEFAULTS,
    solver: str = "ipopt",
    options: dict[str, object] | None = None,
) -> MPCCSolution:
    """Solve a problem from ``x0`` (n,) at parameters ``p``, and certify the answer.

    Each strategy relaxes the pairs until their active set shows; a branch that holds it is solved,
    and exchanged as long as the linear program with complementarity constraints finds descent
    (:mod:`ocp.routes.branches`). Complementarity problems have many local minima, and strategies
    end in different ones: all are tried and the cheapest certified answer returned, but from a
    thousand variables on the first certified one. Where none is feasible, what is off is named.

    Raises :class:`~ocp.errors.InputError` for sizes that do not fit, unknown names, or a start that
    is not finite.
    """
    began = time.perf_counter()
    start = _sized(mpcc.name, "x0", x0, mpcc.x.numel())
    if not np.all(np.isfinite(start)):
        at = int(np.flatnonzero(~np.isfinite(start))[0])
        raise InputError(f"{mpcc.name}: x0[{at}] is {start[at]}, expected a finite number")
    given = _sized(mpcc.name, "p", p, mpcc.p.numel()) if mpcc.p.numel() else np.zeros(0)
    for name in strategies:
        if name not in STRATEGIES:
            raise InputError(f"unknown strategy {name!r}; there are {', '.join(STRATEGIES)}")
    programs = Programs(mpcc, given)
    values = {"penalty": 0.0, "relaxation": 0.0}
    follower = Homotopy(programs, Solver(solver, dict(options or {})), values)
    inside = np.clip(start, *mpcc.x_bounds)
    reference = Reference(impulse=1.0, gap=1.0)
    best: MPCCSolution | None = None
    for name in strategies:
        route = Route(name, reference, lambda program: Point(program.extended(inside)))
        result, program, _ = solve_pairs(follower, route)
        found = _judged(programs("none"), program, result, inside, name)
        if best is None or _rank(found) < _rank(best):
            best = found
        if best.success and program.n >= _LARGE:
            break
    assert best is not None
    spent = {"iterations": follower.trace.iterations, "seconds": time.perf_counter() - began}
    return MPCCSolution(**{**vars(best), **spent})


def _rank(found: MPCCSolution) -> tuple[bool, bool, float]:
    infeasible = found.infeasibility > TOLERANCES["constraint_violation"]
    return infeasible, not found.success, found.infeasibility if infeasible else found.f


def _judged(
    program: MPCCProgram, source: Program, result: Result, start: np.ndarray, name: str
) -> MPCCSolution:
    """Certify a result where it is feasible; else say which constraint is off most."""
    values = {"penalty": 0.0, "relaxation": 0.0}
    mpcc, x = program.mpcc, program.extended(result.point.x[: program.mpcc.x.numel()])
    p, bounds = program.parameter_vector(values), program.bounds(values)
    off, worst = violation(program, x, p, bounds)
    sides = program.lifted.sides(x[: mpcc.x.numel()], program.given)
    G, H = (np.array(v).ravel() for v in sides)
    apart = np.abs(np.minimum(G, H))
    if apart.size and apart.max() > off:
        off, worst = float(apart.max()), f"complementarity of {mpcc.pair(int(apart.argmax()))!r}"
    certificate = Certificate("undecided", reason="the point is not feasible")
    status = Status.INEXACT if result.ok else result.status
    if off <= TOLERANCES["constraint_violation"]:
        own = result.point if source is program else None
        multipliers = own.lam_g if own is not None else None
        certificate = certify(program, x, p, bounds, multipliers, _span(program, start, x, p))
        decided = {"not": Status.NOT_OPTIMAL, "undecided": Status.UNDECIDED}
        status = decided.get(certificate.stationarity, Status.SOLVED)
    elif result.status in (Status.SOLVED, Status.INFEASIBLE):
        status = Status.INFEASIBLE
    f = float(program.f_g(x, p)[0])
    return MPCCSolution(x[: mpcc.x.numel()], G, H, f, status, certificate, off, worst, name, 0, 0.0)


def _span(program: MPCCProgram, start: np.ndarray, x: np.ndarray, p: np.ndarray) -> float:
    """What the cost changes by: on the way from the start, and there by characteristic sizes.

    The latter to second order, for a start at which the cost has no slope.
    """
    begin = program.extended(start)
    sizes = program.sizes(begin)
    f, gradient = program.gradient(begin, p)
    bend = np.abs(program.hessian(begin, p, 1.0, np.zeros(program.m)).sparse())
    slope = np.abs(np.array(gradient).ravel()) @ sizes
    spans = np.array([abs(float(f) - float(program.f_g(x, p)[0])), slope, sizes @ (bend @ sizes)])
    return float(np.max(spans[np.isfinite(spans)], initial=0.0))
