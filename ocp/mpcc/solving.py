"""Solution of a complementarity problem from a start: a certified point, or the least violation."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import count

import casadi as ca
import numpy as np

from ocp.errors import InputError, choose
from ocp.judge.audit import TOLERANCES
from ocp.judge.certificate import UNJUDGED, Certificate, certify
from ocp.judge.findings import compose_lines
from ocp.judge.jumps import Domain, jump_findings_of
from ocp.judge.unbounded import unbounded_variables
from ocp.mpcc.multipliers import Multipliers, multipliers_at
from ocp.mpcc.programs import MPCC, MPCCProgram, programs_of, sized
from ocp.programs.program import PENALTY, RELAXATION, Program
from ocp.programs.solver import Point, Result, Solver, Status
from ocp.routes.branches import Branches
from ocp.routes.complementarity import RelaxationPlan, by_strategy
from ocp.routes.homotopy import COST_GAIN, Homotopy, lower
from ocp.routes.pieces import polish
from ocp.routes.relaxations import STRATEGIES
from ocp.routes.schedules import improve


def violation(program: Program, x: np.ndarray, p: np.ndarray, bounds: dict[str, np.ndarray]) -> tuple[float, str]:
    """Return the largest violation at x, in natural units, and the name of the violated bound or constraint."""
    _, g = program.values(x, p)
    worst, name, units = 0.0, "nothing", program.natural
    layouts = (("bound on", program.variables, x, "x", units.x), ("constraint", program.constraints, g, "g", units.g))
    for kind, layout, values, letter, unit in layouts:
        violations = np.maximum(bounds[f"lb{letter}"] - values, values - bounds[f"ub{letter}"]) / unit
        if violations.size and not violations.max() <= worst:
            position = int(np.argmax(np.nan_to_num(violations, nan=np.inf)))
            block, index = layout.locate(position)
            title = block.components[index[-1]] if block.components else f"{block.name}{[*index]}"
            worst, name = float(violations[position]), f"{kind} {title}"
    return worst, name


Callback = Callable[[int, np.ndarray], None]
"""Function of the number of runs of the solver so far, and of x (n,) after the last one."""
DEFAULTS = ("l1-quick", "scholtes-quick")
"""Default strategies: an exact penalty, which is cheaper, and a relaxation, which is more robust."""
DEFAULTS_LARGE = ("l1-quick", "scholtes-exact", "scholtes-quick")
"""Default strategies of large problems, where slow stages find better minima. The last strategy is used
only if no solution of the others is certified."""
_LARGE = 300
"""Number of variables from which a problem is large; its solutions are improved only until one is certified."""
_MAX_FAILURES = 6
"""Number of failed neighbours in a row that ends a search. With 20, no cost of MacMPEC is lower."""
_NEAR_BOUND = 1e-8
"""Distance from a bound, in characteristic sizes, up to which a variable is moved onto it."""
_COARSE = 2.0**7
"""Ratio of a variable's units at the start and at a solution above which the solve is repeated from the solution."""
_SOFT = ((1.0, 10.0), (1.0, 1000.0), (0.0, 1.0))
"""Weights of cost and violation in softened problems, which are solved if no solution is certified."""


@dataclass(frozen=True)
class MPCCSolution:
    """Solution of an :class:`MPCC`: x (n,), the values of G and H (k,) at x, cost and certificate.

    ``success`` means feasible to 1e-6 and certified B-stationary, whatever the solver's status.
    ``infeasibility`` is the largest violation of a bound, of g, or of min(G, H) = 0, each in the
    unit of its derived size (1 for ordinary sizes); ``worst`` is the name of the violated item.
    ``strategy`` is the name of the strategy that found x. ``findings`` are sentences on functions
    that jump, or on a cost that is unbounded below. ``multipliers`` are those at a feasible x, else None.
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
    findings: tuple[str, ...] = ()
    multipliers: Multipliers | None = None

    @property
    def success(self) -> bool:
        """Whether the solution is feasible and certified."""
        return self.status is Status.SOLVED

    @property
    def verdict(self) -> str:
        """Status, cost, certificate and findings in a sentence or two."""
        if self.status is Status.INFEASIBLE:
            return f"Locally infeasible: {self.worst} cannot be met near the last point."
        status_text = self.status.value.partition(":")[0].capitalize()
        certified = [] if self.status is Status.UNBOUNDED else [f"{self.certificate.sentence}."]
        return f"{status_text}: cost {self.f:.8g}; " + " ".join([*certified, *self.findings])


def solve(
    mpcc: MPCC,
    x0: float | Sequence[float] | np.ndarray = 0.0,
    p: Sequence[float] | np.ndarray = (),
    strategies: Sequence[str] | None = None,
    solver: str = "ipopt",
    options: dict[str, object] | None = None,
    warm: bool = False,
    callback: Callback | None = None,
) -> MPCCSolution:
    """Solve a problem from ``x0`` (n,) at parameters ``p``, and certify the solution.

    Each strategy relaxes the pairs until their active set is identified. The branch with this active
    set is solved, then neighbouring branches as long as the linear program with complementarity
    constraints finds descent (:mod:`ocp.routes.branches`). Complementarity problems have many local
    minima, and strategies find different ones: all are tried, and the cheapest certified solution is
    returned. For 300 variables or more, branches are improved in the order of their costs until one is
    certified. ``strategies`` are by default :data:`DEFAULTS` or, for problems of this size,
    :data:`DEFAULTS_LARGE`. If no solution is certified, constraints are softened (:func:`softened`),
    which allows more equations than variables. If no point is feasible, the verdict names the violation.

    A ``warm`` solve begins with the branch nearest to ``x0`` and its neighbours, and returns a certified
    solution of these without following any strategy or searching for jumps. ``callback`` is called after
    each run of the solver with the number of runs so far and x (n,).

    Raises :class:`~ocp.errors.InputError` for sizes that do not fit, unknown names, or a start that
    is not finite.
    """
    start_time = time.perf_counter()
    start = sized(mpcc.name, "x0", x0, mpcc.x.numel())
    if not np.all(np.isfinite(start)):
        index = int(np.flatnonzero(~np.isfinite(start))[0])
        raise InputError(f"{mpcc.name}: x0[{index}] is {start[index]}, expected a finite number")
    parameter_values = sized(mpcc.name, "p", p, mpcc.p.numel()) if mpcc.p.numel() else np.zeros(0)
    constant = float(mpcc.lifted.constant(parameter_values))
    if not np.isfinite(constant):
        raise InputError(f"{mpcc.name}: constant terms of the cost are {constant:g}; expected finite numbers")
    for name in strategies or ():
        choose("strategy", name, STRATEGIES)
    inside, nlp_solver = np.clip(start, *mpcc.x_bounds), Solver(solver, dict(options or {}))
    if callback is not None:
        runs = count()
        nlp_solver.on_result = lambda _, result: callback(next(runs), result.point.x[: start.size])
    if warm and (nearest := _nearest(mpcc, inside, parameter_values, nlp_solver)).success:
        return replace(nearest, seconds=time.perf_counter() - start_time)
    best, follower = _followed(mpcc, inside, parameter_values, strategies, nlp_solver)
    if _feasible(best) and _coarse(follower, best.x):
        second_answer, second_follower = _followed(mpcc, best.x, parameter_values, strategies, nlp_solver)
        second_follower.trace.absorb(follower.trace)
        # A second solution that costs no less may have drifted to where rows lose their digits.
        gain = COST_GAIN * abs(best.f) if best.success else 0.0
        if _feasible(second_answer) and second_answer.f <= best.f - gain:
            best, follower = second_answer, second_follower
    if not best.success:
        best = _softened(best, follower, inside, strategies)
    findings = _jump_findings(mpcc, parameter_values, best.x) if _feasible(best) else ()
    if endless := _endless(follower, best.x, inside):
        best, findings = replace(best, status=Status.UNBOUNDED), (endless,)
    seconds = time.perf_counter() - start_time
    return replace(best, iterations=follower.trace.iterations, seconds=seconds, findings=findings)


def _nearest(mpcc: MPCC, start: np.ndarray, parameter_values: np.ndarray, solver: Solver) -> MPCCSolution:
    """Return the solution of the branch nearest to ``start`` (n,), exchanged for better neighbours."""
    follower = Homotopy(programs_of(mpcc, parameter_values, start), solver, {PENALTY: 0.0, RELAXATION: 0.0})
    program = follower.nlp_of("none")
    assert isinstance(program, MPCCProgram)
    p = program.parameter_vector(follower.values)
    begin = Result.at(program, Point(program.extended(start)), p, Status.FAILED, "warm start")
    leg = polish(follower, program, begin)
    solution = _judged(program, leg.nlp, leg.result, start, "warm start")
    return replace(solution, iterations=follower.trace.iterations)


def _coarse(follower: Homotopy, x: np.ndarray) -> bool:
    """Return whether a very large start made the units of variables too large for judging the solution x (n,).

    Units from ordinary starts are not changed: a solution near zero does not make a variable small.
    """
    program = follower.nlp_of("none")
    assert isinstance(program, MPCCProgram)
    return bool(np.any((program.units > 1) & (program.units_at(x) < program.units / _COARSE)))


def _endless(follower: Homotopy, x: np.ndarray, start: np.ndarray) -> str:
    """Return a sentence on a cost unbounded below from x (n,) or ``start`` with closed pairs; empty if bounded."""
    program, values = follower.nlp_of("none"), follower.values
    assert isinstance(program, MPCCProgram)
    extended_solution, guess = program.extended(x), program.extended(start)
    smaller = program.pairs[np.argmin(guess[program.pairs], axis=0), np.arange(len(program.pairs.T))]
    guess[smaller] = 0.0
    arguments = program.parameter_vector(values), program.bounds(values)
    endless = unbounded_variables(program, *arguments, extended_solution, guess)
    return f"{endless}." if endless else ""


def _jump_findings(mpcc: MPCC, p: np.ndarray, x: np.ndarray) -> tuple[str, ...]:
    """Return sentences on functions that jump within the bounds on x, on lines around zero and ``x`` (n,)."""
    functions = {"f": mpcc.f, "g": mpcc.g, "G": mpcc.G, "H": mpcc.H}
    evaluated = {name: ca.substitute(function, mpcc.p, p) for name, function in functions.items()}
    domain = Domain(np.fmax(1, np.abs(x)), *mpcc.x_bounds, x)
    return tuple(compose_lines(jump_findings_of(evaluated, mpcc.x, domain)))


def _followed(
    mpcc: MPCC, start: np.ndarray, parameter_values: np.ndarray, strategies: Sequence[str] | None, solver: Solver
) -> tuple[MPCCSolution, Homotopy]:
    """Return the best solution of all strategies from ``start`` (n,), each improved, and the homotopy."""
    programs = programs_of(mpcc, parameter_values, start)

    def start_point(program: MPCCProgram) -> Point:
        return Point(program.extended(start))

    follower = Homotopy(programs, solver, {PENALTY: 0.0, RELAXATION: 0.0})
    branches = Branches(follower)
    large = branches.program.n >= _LARGE
    names = strategies or (DEFAULTS_LARGE if large else DEFAULTS)
    solutions: list[MPCCSolution] = []
    improved: list[Result] = []
    for batch in (names[:2], names[2:]) if large else (names,):
        plans = [(name, RelaxationPlan(STRATEGIES[name], 1.0, start_point)) for name in batch]
        legs = [(name, by_strategy(follower, plan, plan.strategy)) for name, plan in plans]
        for name, leg in sorted(legs, key=lambda leg: (not leg[1].finished, leg[1].result.f)):
            if leg.finished and _is_solved(branches, leg.result, improved):
                continue
            result = improve(branches, leg.result, _MAX_FAILURES) if leg.finished else leg.result
            improved += [leg.result] if leg.finished else []
            solutions.append(_judged(programs("none"), leg.nlp, result, start, name))
            if large and solutions[-1].success:
                return solutions[-1], follower
    return min(solutions, key=_rank), follower


def _is_solved(branches: Branches, result: Result, others: list[Result]) -> bool:
    """Return whether one of ``others`` is on the same branch as ``result`` and costs no more."""
    active = branches.schedule(result.point.x)
    return any(
        np.array_equal(active, branches.schedule(other.point.x)) and not lower(result, other) for other in others
    )


def softened(mpcc: MPCC, cost: float, weight: float) -> MPCC:
    """Return ``min cost f + weight sum(a + b)`` with ``lbg <= g - a + b <= ubg`` and the same pairs.

    The last variables a, b >= 0 (m,) are the violations of upper and of lower limits: every point with
    complementary pairs is feasible, whatever the rank of the rows. For a large weight the minima are those of
    the problem (exact penalty); without the cost they have the least violation.
    """
    m, (lower, upper) = mpcc.g.numel(), mpcc.x_bounds
    a, b = ca.SX.sym("above", m), ca.SX.sym("below", m)
    return MPCC(
        ca.vertcat(mpcc.x, a, b),
        cost * mpcc.f + weight * ca.sum1(a + b),
        mpcc.G,
        mpcc.H,
        mpcc.g - a + b,
        mpcc.p,
        np.concatenate([lower, np.zeros(2 * m)]),
        np.concatenate([upper, np.full(2 * m, np.inf)]),
        *mpcc.g_bounds,
        mpcc.names,
        mpcc.name,
        mpcc.row_names,
    )


def _softened(
    best: MPCCSolution, follower: Homotopy, start: np.ndarray, strategies: Sequence[str] | None
) -> MPCCSolution:
    """Return the best of ``best`` and the polished solutions of softened problems with growing weights.

    If no solution is feasible, the problem is solved without the cost, from the point of least violation so far.
    """
    program = follower.nlp_of("none")
    assert isinstance(program, MPCCProgram)
    mpcc, values = program.mpcc, follower.values
    (lower, upper), p = mpcc.g_bounds, program.parameter_vector(values)
    for cost, weight in _SOFT:
        if best.success or (cost == 0 and _feasible(best)):
            break
        guess = start if cost else best.x
        g = program.values(program.extended(guess), p)[1][: mpcc.g.numel()]
        violations = np.nan_to_num([np.maximum(g - upper, 0.0), np.maximum(lower - g, 0.0)])
        soft = softened(mpcc, cost, weight * program.natural.f)
        relaxed, inner = _followed(
            soft, np.concatenate([guess, *violations]), program.p_values, strategies, follower.solver
        )
        follower.trace.absorb(inner.trace)
        point = Point(program.extended(relaxed.x[: mpcc.x.numel()]))
        projected = Result.at(program, point, p, Status.INFEASIBLE, "softened")
        polished = polish(follower, program, projected)
        for nlp, result in ((program, projected), (polished.nlp, polished.result)):
            best = min(best, _judged(program, nlp, result, start, relaxed.strategy), key=_rank)
    return best


def _at_bounds(program: MPCCProgram, x: np.ndarray, p: np.ndarray, bounds: dict[str, np.ndarray]) -> np.ndarray:
    """Return x with variables near a bound moved to the bound, if the cost decreases and constraints still hold.

    An interior-point solution keeps a distance from bounds, which increases a steep cost noticeably.
    """
    tolerance, snapped = _NEAR_BOUND * program.sizes(x), x
    for bound in (bounds["lbx"], bounds["ubx"]):
        snapped = np.where(np.abs(snapped - bound) <= tolerance, bound, snapped)
    feasible = violation(program, snapped, p, bounds)[0] <= TOLERANCES["constraint_violation"]
    return snapped if feasible and program.values(snapped, p)[0] < program.values(x, p)[0] else x


def _feasible(solution: MPCCSolution) -> bool:
    return solution.infeasibility <= TOLERANCES["constraint_violation"]


def _rank(solution: MPCCSolution) -> tuple[bool, bool, float]:
    feasible = _feasible(solution)
    return not feasible, not solution.success, solution.f if feasible else solution.infeasibility


def _judged(program: MPCCProgram, source: Program, result: Result, start: np.ndarray, name: str) -> MPCCSolution:
    """Convert a solver's result to a solution: certified if feasible, else with the most violated constraint's name."""
    values = {PENALTY: 0.0, RELAXATION: 0.0}
    mpcc, x = program.mpcc, program.extended(result.point.x[: program.mpcc.x.numel()])
    p, bounds = program.parameter_vector(values), program.bounds(values)
    x = _at_bounds(program, x, p, bounds)
    infeasibility, worst = violation(program, x, p, bounds)
    G_and_H = program.lifted.sides(x[: mpcc.x.numel()], program.p_values)
    G, H = (np.array(v).ravel() for v in G_and_H)
    units = program.natural.x[program.pairs]
    complementarity = np.abs(np.minimum(G / units[0], H / units[1]))
    if complementarity.size and complementarity.max() > infeasibility:
        infeasibility = float(complementarity.max())
        worst = f"complementarity of {mpcc.pair(int(complementarity.argmax()))!r}"
    certificate, lagrange = Certificate("undecided", reason=UNJUDGED), None
    status = Status.INEXACT if result.ok else result.status
    if infeasibility <= TOLERANCES["constraint_violation"]:
        multipliers = result.point.lam_g if source is program else None
        certificate = certify(program, x, p, bounds, multipliers)
        lagrange = multipliers_at(program, x, p, bounds, multipliers)
        decided = {"not": Status.NOT_OPTIMAL, "undecided": Status.UNDECIDED}
        status = decided.get(certificate.stationarity, Status.SOLVED)
    elif result.status in (Status.SOLVED, Status.INFEASIBLE):
        status = Status.INFEASIBLE
    f = program.values(x, p)[0] + program.constant(p)
    x = x[: mpcc.x.numel()]
    return MPCCSolution(x, G, H, f, status, certificate, infeasibility, worst, name, 0, 0.0, multipliers=lagrange)
