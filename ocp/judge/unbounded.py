"""Search for rays along which a cost decreases without bound, or towards a value that no point attains."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import product
from typing import Any

import casadi as ca
import numpy as np

from dynamics.contact import Step
from ocp.judge.constraints import CONSTRAINT_SHARE, broken_constraints
from ocp.judge.findings import make_finding
from ocp.judge.lpec import LinearModel
from ocp.problem.cost_sizes import least_value, split_constant
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import Rollout, roll_on
from ocp.programs.program import Program

Ray = tuple[str, Callable[[float], float], float]
"""A ray: names of the variables that move, function from a distance ``t`` to the cost there (NaN if the point is
not feasible), and distance of the first point from zero; distances are in characteristic sizes."""
_NEAR_DISTANCES = np.array([0.25, 0.5, 1.0, 2.0])
"""First distances along a ray, in characteristic sizes."""
_FAR_DISTANCES = 10.0 ** np.arange(1, 8)
"""Further distances, in characteristic sizes, or in distances of the ray's first point if that is larger."""
_FIRST_DISTANCE = 1e3
"""Distance along a ray at which the cost is evaluated first, in the unit of :data:`_FAR_DISTANCES`."""
_LEAST_RATIO = 0.9
"""Ratio of the decreases in successive decades above which a cost is unbounded; a logarithm has the ratio 1."""
_RELATIVE_ROUNDING = 1e-12
"""Relative rounding error of a cost."""
_LEAST_FALLS = 4
"""Minimum number of successive decreases of a cost that keeps decreasing."""
_BEFORE_FLAT = 0.9
"""Fraction of the distance to where the cost is flat, at which the remaining decrease is measured."""
_ROUNDED_FALL = 1e-5
"""Remaining decrease, relative to the decrease, that is rounding, as for an exponential; before a kink it is more."""
_DISTANT_START = 10.0
"""Distance of the solution from zero, in characteristic sizes, above which rays from the start are tried too."""
_RUN_AWAY = 1e6
"""Distance, in characteristic sizes, above which a solver's iterates have diverged."""
_RAY_TOLERANCE = 1e-6
"""Violation, in characteristic sizes, up to which a point of a ray is feasible."""
_MOST_SINGLES = 100
"""Maximum number of variables of a program for which each variable is also moved alone."""
_MOST_PAIRED = 6
"""Maximum number of inputs for which every two inputs are also moved together."""


def describe_endless_ray(rays: Iterable[Ray], best: float, tolerance: float = 0.0) -> str:
    """Return a clause on the first ray along which the cost decreases for ever, or "".

    ``best`` is the cost of the solution; changes up to ``tolerance`` count as zero.
    """
    for variables, cost, reach in rays:
        if description := describe_fall(cost, reach, best, tolerance):
            return make_finding("unbounded", fall=description.format(variables)).sentence
    return ""


def describe_fall(cost: Callable[[float], float], reach: float, best: float, tolerance: float) -> str:
    """Return how ``cost(t)`` decreases: without bound, towards a value that no point attains, or "" for neither.

    The cost decreases without bound if it decreases by about as much or more in each successive one of the last three
    decades of ``t``. It decreases towards a value if it never increases but decreases by less and less, like
    ``exp(-t)``. In both cases it must not end above ``best``; changes up to ``tolerance`` count as zero.
    """
    times = np.concatenate([[0.0], _NEAR_DISTANCES, max(reach, 1.0) * _FAR_DISTANCES])
    # Most rays end here: the cost is higher far away.
    if not cost(max(reach, 1.0) * _FIRST_DISTANCE) <= best:
        return ""
    costs = np.array([cost(t) for t in times])
    if not costs[-1] < min(costs[0], np.nextafter(best, np.inf)):
        return ""
    steps, size = np.diff(costs), np.abs(costs)
    rounding, last = tolerance + _RELATIVE_ROUNDING * np.fmax(size[1:], size[:-1]), -steps[-3:]
    if np.all(last > rounding[-3:]) and np.all(last[1:] > _LEAST_RATIO * last[:-1]):
        return "decreases without bound along {}"
    falls = int(np.argmin([*(steps < -rounding), False]))
    if falls < _LEAST_FALLS or not np.all(steps <= rounding):
        return ""
    near_time, flat_time = 0.0, times[-1]
    while steps[-1] >= -rounding[-1] and flat_time - near_time > _RAY_TOLERANCE * flat_time:
        middle = (near_time + flat_time) / 2
        near_time, flat_time = (near_time, middle) if cost(middle) <= costs[-1] else (middle, flat_time)
    remaining_fall = cost(_BEFORE_FLAT * flat_time) - costs[-1]
    if flat_time < times[-1] and remaining_fall > _ROUNDED_FALL * (costs[0] - costs[-1]):
        return ""
    return "keeps decreasing along {} towards a value that no point attains"


def unbounded_inputs(evaluation: Evaluation, step: Step, plan: Rollout) -> str:
    """Return a clause on inputs without bounds along which the plan's cost decreases for ever, or ""."""
    rays = _input_rays(evaluation, step, plan, _cost_of_inputs(evaluation))
    return describe_endless_ray(rays, plan.cost, 1e-3 * _RELATIVE_ROUNDING * evaluation.problem.scales.cost)


def _cost_of_inputs(evaluation: Evaluation) -> Callable[[np.ndarray], float] | None:
    """Return the function from inputs (N, nu) to the cost of inputs alone; None if other costs can be negative."""
    problem = evaluation.problem
    system, p = problem.system, problem.parameters
    du = ca.SX.sym("du", system.nu) if problem.du is None else problem.du
    costs = [problem.stage_cost, problem.terminal_cost]
    stage, terminal = ca.substitute(costs, [p.vector], [ca.DM(evaluation.p)])
    remaining_cost, of_inputs = split_constant(stage, ca.vertcat(system.x, system.lam))
    if min(least_value(remaining_cost), least_value(terminal)) < 0:
        return None
    stage_cost = ca.Function("cost_of_inputs", [system.u, du], [of_inputs])
    u_before = evaluation.limits.u_before
    return lambda u: float(ca.sum2(stage_cost(u.T, np.diff(u, axis=0, prepend=u_before[None]).T)))


def runaway_inputs(problem: Problem, u: np.ndarray) -> str:
    """Return a clause on inputs (S, N, nu) that are more than a million sizes from zero, or ""."""
    is_far = np.abs(np.nan_to_num(u) / problem.scales.u).max(axis=(0, 1)) > _RUN_AWAY
    runaways = [signal.name for signal, is_away in zip(problem.system.inputs, is_far, strict=True) if is_away]
    if not runaways:
        return ""
    return make_finding("iterates-ran-away", variables=" and ".join(runaways)).sentence


def _input_rays(
    evaluation: Evaluation, step: Step, plan: Rollout, least_cost: Callable[[np.ndarray], float] | None
) -> Iterator[Ray]:
    """Yield rays along which inputs without bounds change at all steps of the horizon.

    A ray moves one input, two inputs at once, or all of them in proportion to the plan. Rays begin at the
    plan and, if the plan is far from zero, also at the guess; their inputs are rolled out under the law.
    A ray is left out if ``least_cost``, a lower bound on the cost of inputs, exceeds the plan's cost.
    """
    problem, limits = evaluation.problem, evaluation.limits
    sizes, low, high = problem.scales.u, np.isfinite(limits.u_lower), np.isfinite(limits.u_upper)
    free = np.flatnonzero(~(low & high))
    planned, guess = np.nan_to_num(plan.u.mean(axis=0)), evaluation.initial_guess[1]
    names = [signal.name for signal in problem.system.inputs]
    patterns = [*np.eye(free.size), *-np.eye(free.size)]
    if free.size <= _MOST_PAIRED:
        patterns = [s for s in product((0, 1, -1), repeat=free.size) if 0 < np.abs(s).sum() <= 2]
    directions = [np.zeros_like(planned) for _ in range(len(patterns) + 1)]
    for direction, pattern in zip(directions, patterns, strict=False):
        direction[:, free] = pattern * sizes[free]
    largest = np.abs(planned / sizes)[:, free].max(initial=0.0)
    directions[-1][:, free] = planned[:, free] / max(largest, 1.0)
    for direction in directions:
        is_moved = np.any(direction != 0, axis=0)
        if not is_moved.any() or np.any((direction > 0) & high | (direction < 0) & low):
            continue
        variables = " and ".join(names[i] for i in np.flatnonzero(is_moved))
        reach = float(np.abs(planned / sizes)[:, is_moved].max())
        # Other inputs are those of the plan: with the inputs of the guess no ray would end below the plan's cost.
        begun = np.where(is_moved, guess, planned)
        for base in (planned, begun) if reach > _DISTANT_START else (planned,):
            if least_cost is not None and least_cost(base + max(reach, 1.0) * _FIRST_DISTANCE * direction) > plan.cost:
                continue
            yield variables, partial(_rolled, evaluation, step, plan.x[:, 0], base, direction), reach


def _rolled(
    evaluation: Evaluation, step: Step, x0: np.ndarray, base: np.ndarray, direction: np.ndarray, t: float
) -> float:
    """Return the cost of inputs ``base + t direction`` (N, nu) from x0 (S, nx), NaN if they are not feasible."""
    rolled, unsolved = roll_on(evaluation, (base + t * direction)[None], step, x0)
    broken = broken_constraints(evaluation, rolled)
    is_feasible = unsolved is None and all(entry.share <= CONSTRAINT_SHARE for entry in broken)
    return rolled.cost if is_feasible else np.nan


def unbounded_variables(
    program: Program,
    p: np.ndarray,
    bounds: dict[str, np.ndarray],
    solution: np.ndarray,
    start: np.ndarray | None = None,
) -> str:
    """Return a clause that names variables along which the cost decreases without bound, or "".

    Rays are straight and begin at the ``solution`` (n,) and, if that is distant or not feasible, at the
    ``start`` (n,), by default the solution.
    """
    model = LinearModel.at(program, solution, p, bounds)
    best = _cost_at(program, model, p, bounds, solution, 0 * solution, 0.0)
    start = solution if start is None else start
    distant = np.abs((solution - start) / program.sizes(start)).max(initial=0.0) > _DISTANT_START
    bases = [solution, start] if distant or np.isnan(best) else [solution]
    rays = (ray for base in bases for ray in _rays(program, base, p, bounds))
    return describe_endless_ray(rays, float(np.nan_to_num(best, nan=np.inf)))


def _rays(program: Program, x: np.ndarray, p: np.ndarray, bounds: dict[str, np.ndarray]) -> Iterator[Ray]:
    """Yield rays along the cost's negative gradient, away from zero, and along each variable of a small program."""
    model = LinearModel.at(program, x, p, bounds)
    directions = [-model.cost, x / model.sizes] if model.finite else []
    if x.size <= _MOST_SINGLES and model.finite:
        directions += [*np.eye(x.size)[np.isinf(model.upper)], *-np.eye(x.size)[np.isinf(model.lower)]]
    for target in directions:
        direction = recession_direction(model, target)
        if direction.any():
            moves = partial(_cost_at, program, model, p, bounds, x, model.sizes * direction)
            yield _called(program, direction), moves, 1.0


def recession_direction(model: LinearModel, preferred: np.ndarray) -> np.ndarray:
    """Return the direction (n,) nearest to ``preferred`` along which all bounds and constraints hold without limit.

    Its largest entry is 1; it is zero if there is no such direction. In every complementarity pair it is zero for
    the smaller member or, if the members are equal, for the member that ``preferred`` increases less. Constraints that
    would otherwise be violated are held constant.
    """
    import scipy.sparse as sp
    import scipy.sparse.linalg as sla

    limits = (model.row_lower, model.row_upper, model.lower, model.upper)
    below, above, lower, upper = (np.isfinite(end) for end in limits)
    rows, is_held, (first, second) = below & above, lower & upper, model.pairs
    opening = model.members[0] - model.members[1]
    opening = np.where(np.abs(opening) > _RAY_TOLERANCE, opening, preferred[first] - preferred[second])
    is_held[np.where(opening > 0, second, first)] = True
    for _ in range(8):
        direction = np.where(is_held, 0.0, preferred)
        A: Any = sp.csr_matrix(model.rows[np.flatnonzero(rows)][:, np.flatnonzero(~is_held)])
        solve = sla.factorized(sp.csc_matrix(A @ A.T + 1e-10 * sp.identity(A.shape[0])))
        for _ in range(3):
            direction[~is_held] -= A.T @ solve(A @ direction[~is_held])
        largest = np.abs(direction).max(initial=0.0)
        if not largest > _RAY_TOLERANCE * np.abs(preferred).max(initial=0.0):
            break
        direction = np.where(np.abs(direction) < 1e-9 * largest, 0.0, direction / largest)
        row_changes = model.rows @ direction
        is_met = ~rows & ((below & (row_changes < -1e-9)) | (above & (row_changes > 1e-9)))
        stopped = ~is_held & ((lower & (direction < 0)) | (upper & (direction > 0)))
        if not (is_met.any() or stopped.any()):
            return direction
        rows, is_held = rows | is_met, is_held | stopped
    return np.zeros(preferred.size)


def _cost_at(
    program: Program,
    model: LinearModel,
    p: np.ndarray,
    bounds: dict[str, np.ndarray],
    base: np.ndarray,
    direction: np.ndarray,
    t: float,
) -> float:
    """Return the cost at ``base + t direction``, NaN if a bound, row or pair is violated beyond rounding errors."""
    x = base + t * direction
    cost, g = program.values(x, p)
    size = np.fmax((abs(model.rows) @ np.abs(x / model.sizes)) / model.row_scale, 1.0)
    violations = [
        np.maximum(bounds["lbg"] - g, g - bounds["ubg"]) / size,
        np.maximum(bounds["lbx"] - x, x - bounds["ubx"]) / model.sizes,
        np.abs(x[model.pairs]).min(axis=0),
    ]
    return cost if all(np.all(violation <= _RAY_TOLERANCE) for violation in violations) else np.nan


def _called(program: Program, direction: np.ndarray) -> str:
    """Return the names of up to three variables that change noticeably along a direction."""
    locations = (program.variables.locate(int(i)) for i in np.flatnonzero(np.abs(direction) > 0.1))
    called = (b.components[index[-1]] if b.components else b.name for b, index in locations)
    return " and ".join(list(dict.fromkeys(called))[:3])
