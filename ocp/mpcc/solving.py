"""From a complementarity problem and a start to a certified answer, or to least violation."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from ocp.errors import InputError, choose
from ocp.judges.audit import TOLERANCES
from ocp.mpcc.programs import MPCC, MPCCProgram, programs_of, sized
from ocp.problem import Scaling
from ocp.programs.program import Functions, Layout, PairName, Program
from ocp.programs.solver import Point, Result, Solver, Status
from ocp.routes.branches import Branches, polish
from ocp.routes.complementarity import Search, solve_pairs
from ocp.routes.homotopy import Homotopy
from ocp.routes.relaxations import STRATEGIES
from ocp.stationarity.certificate import Certificate, certify


class Elastic(Program):
    """``min sum(a + b)`` subject to ``g_lower <= g(x, p) - a + b <= g_upper``, the same pairs.

    a, b >= 0 (m,) are what rows are above and below their limits. Bounds of x and complementarity
    are kept, so every point with complementary pairs can be made feasible.
    """

    def __init__(self, base: Program) -> None:
        self.base, self.pairs, self.solvers = base, base.pairs, {}
        self.reformulation = base.reformulation
        self.variables, self.constraints = Layout(), base.constraints
        for name, block in base.variables.blocks.items():
            self.variables.add(name, block.shape, block.components)
        self.variables.add("above", (base.m,))
        self.variables.add("below", (base.m,))
        n, m = base.n, base.m
        z, p = ca.MX.sym("z", n + 2 * m), ca.MX.sym("p", base.n_parameters)
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", m)
        x, above, below = z[:n], z[n : n + m], z[n + m :]
        f = ca.sum1(above) + ca.sum1(below)
        g, jacobian = base.jacobian(x, p)
        moved, one = g - above + below, ca.MX.eye(m)
        slope = ca.vertcat(ca.MX.zeros(n), ca.MX.ones(2 * m))
        hessian = ca.diagcat(base.hessian(x, p, 0.0, lam_g), ca.MX(2 * m, 2 * m))
        wide = ca.horzcat(jacobian, -one, one)
        self.f_g, self.gradient, self.jacobian, self.hessian = Functions.of(
            (z, p, lam_f, lam_g), (f, moved), (f, slope), (moved, wide), hessian
        )

    @property
    def title(self) -> str:
        """Name of the problem."""
        return self.base.title

    def parameter_vector(self, values: dict[str, float]) -> np.ndarray:
        """The problem's own."""
        return self.base.parameter_vector(values)

    def bounds(self, values: dict[str, float]) -> dict[str, np.ndarray]:
        """The problem's own, and violations from zero on."""
        own, m = self.base.bounds(values), self.base.m
        lower, upper = np.zeros(2 * m), np.full(2 * m, np.inf)
        return {
            **own,
            "lbx": np.concatenate([own["lbx"], lower]),
            "ubx": np.concatenate([own["ubx"], upper]),
        }

    def sizes(self, x: np.ndarray) -> np.ndarray:
        """The problem's own; 1 for violations."""
        return np.concatenate([self.base.sizes(x[: self.base.n]), np.ones(2 * self.base.m)])

    def pair_name(self, index: int) -> PairName:
        """The problem's own."""
        return self.base.pair_name(index)

    def lifted(self, x: np.ndarray, p: np.ndarray, limits: dict[str, np.ndarray]) -> np.ndarray:
        """Add to x (n,) the violations that it has."""
        _, g = self.base.values(x, p)
        off = [np.maximum(g - limits["ubg"], 0.0), np.maximum(limits["lbg"] - g, 0.0)]
        return np.concatenate([x, *np.nan_to_num(off)])


def restored(follower: Homotopy, x: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Minimise violation over branches from a point of the program as reformulation "none".

    Branch and improve as for any cost (:class:`~ocp.routes.branches.Branches`); a violation left at
    the end is a local minimum over all branches to first order. Returns the point and its sum of
    violations, None where no branch was solved.
    """
    base = follower.nlp_of("none")
    elastic = Elastic(base)
    inner = Homotopy(lambda _: elastic, follower.solver, follower.values, follower.progress,
                     follower.trace)  # fmt: skip
    branches = Branches(inner)
    own = base.bounds(follower.values)
    inside = np.clip(x, own["lbx"], own["ubx"])
    start = Point(elastic.lifted(inside, branches.p, own))
    found = branches.solve_branch(start) or branches.propose(start)
    if found is None:
        return None
    found = branches.improve(found)
    return found.point.x[: base.n], found.f


def violation(
    program: Program, x: np.ndarray, p: np.ndarray, bounds: dict[str, np.ndarray]
) -> tuple[float, str]:
    """Return the largest violation of a bound or constraint at x, and its name."""
    _, g = program.values(x, p)
    worst, name = 0.0, "nothing"
    parts = (("bound on", program.variables, x, "x"), ("constraint", program.constraints, g, "g"))
    for what, layout, values, letter in parts:
        off = np.maximum(bounds[f"lb{letter}"] - values, values - bounds[f"ub{letter}"])
        if off.size and not off.max() <= worst:
            at = int(np.argmax(np.nan_to_num(off, nan=np.inf)))
            block, index = layout.locate(at)
            called = block.components[index[-1]] if block.components else f"{block.name}{[*index]}"
            worst, name = float(off[at]), f"{what} {called}"
    return worst, name


DEFAULTS = ("l1-quick", "scholtes-quick")
"""Strategies that are tried: an exact penalty is cheapest, the relaxation bears more."""
_LARGE = 300
"""Variables from which on the first certified answer is taken."""


@dataclass(frozen=True)
class MPCCSolution:
    """An answer to an :class:`MPCC`: x (n,), G and H (k,) there, cost and certificate.

    ``success`` means feasible to 1e-6 and certified B-stationary, whatever the solver's status.
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
    end in different ones: all are tried and the cheapest certified answer returned, but from 300
    variables on the first certified one. Where none is feasible, violation is minimised
    over branches and what is left of it is named.

    Raises :class:`~ocp.errors.InputError` for sizes that do not fit, unknown names, or a start that
    is not finite.
    """
    began = time.perf_counter()
    start = sized(mpcc.name, "x0", x0, mpcc.x.numel())
    if not np.all(np.isfinite(start)):
        at = int(np.flatnonzero(~np.isfinite(start))[0])
        raise InputError(f"{mpcc.name}: x0[{at}] is {start[at]}, expected a finite number")
    given = sized(mpcc.name, "p", p, mpcc.p.numel()) if mpcc.p.numel() else np.zeros(0)
    for name in strategies:
        choose("strategy", name, STRATEGIES)
    inside = np.clip(start, *mpcc.x_bounds)
    programs = programs_of(mpcc, given, inside)
    values = {"penalty": 0.0, "relaxation": 0.0}
    follower = Homotopy(programs, Solver(solver, dict(options or {})), values)
    scaling = Scaling(impulse=1.0, gap=1.0)
    best: MPCCSolution | None = None
    for name in strategies:
        search = Search(STRATEGIES[name], scaling, lambda program: Point(program.extended(inside)))
        end = solve_pairs(follower, search)
        found = _judged(programs("none"), end.nlp, end.result, inside, name)
        if best is None or _rank(found) < _rank(best):
            best = found
        if best.success and end.nlp.n >= _LARGE:
            break
    assert best is not None
    if best.infeasibility > TOLERANCES["constraint_violation"]:
        best = _restored(follower, programs("none"), best, inside)
    spent = {"iterations": follower.trace.iterations, "seconds": time.perf_counter() - began}
    return MPCCSolution(**{**vars(best), **spent})


def _restored(
    follower: Homotopy, program: MPCCProgram, end: MPCCSolution, start: np.ndarray
) -> MPCCSolution:
    """Polish from where violation is least near an infeasible end; keep the better of both."""
    least = restored(follower, program.extended(end.x))
    if least is None:
        return end
    x, p = least[0], program.parameter_vector(follower.values)
    there = Result.at(program, Point(x), p, Status.INFEASIBLE, "restored")
    polished = polish(follower, program, there)
    found = _judged(program, polished.nlp, polished.result, start, end.strategy)
    return found if _rank(found) < _rank(end) else end


def _rank(found: MPCCSolution) -> tuple[bool, bool, float]:
    infeasible = found.infeasibility > TOLERANCES["constraint_violation"]
    return infeasible, not found.success, found.infeasibility if infeasible else found.f


def _judged(
    program: MPCCProgram, source: Program, result: Result, start: np.ndarray, name: str
) -> MPCCSolution:
    """Certify a result where it is feasible; else name the most violated constraint."""
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
        multipliers = result.point.lam_g if source is program else None
        certificate = certify(program, x, p, bounds, multipliers, _span(program, start, x, p))
        decided = {"not": Status.NOT_OPTIMAL, "undecided": Status.UNDECIDED}
        status = decided.get(certificate.stationarity, Status.SOLVED)
    elif result.status in (Status.SOLVED, Status.INFEASIBLE):
        status = Status.INFEASIBLE
    f, _ = program.values(x, p)
    return MPCCSolution(x[: mpcc.x.numel()], G, H, f, status, certificate, off, worst, name, 0, 0.0)


def _span(program: MPCCProgram, start: np.ndarray, x: np.ndarray, p: np.ndarray) -> float:
    """What the cost changes by: on the way from the start, and there by characteristic sizes."""
    begin = program.extended(start)
    change = abs(program.values(begin, p)[0] - program.values(x, p)[0])
    return max(change if np.isfinite(change) else 0.0, program.span(begin, p))
