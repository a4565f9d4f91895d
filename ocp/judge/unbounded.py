"""Costs that fall without end, or towards a value that no point attains, along rays."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from itertools import product
from typing import Any

import casadi as ca
import numpy as np

from dynamics.contact import Step
from ocp.judge.certificate import linear_model
from ocp.judge.constraints import CONSTRAINT_SHARE, broken_constraints
from ocp.judge.lpec import LinearModel
from ocp.problem.cost_sizes import least_value, split_constant
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import Rollout, roll_on
from ocp.programs.program import Program

Ray = tuple[str, Callable[[float], float], float]
"""What moves, the cost ``t`` characteristic sizes along, NaN where that is not feasible, and how
many sizes the ray's first point is from zero."""
_NEAR, _DECADES = np.array([0.25, 0.5, 1.0, 2.0]), 10.0 ** np.arange(1, 8)
"""Distances along a ray in sizes, and in those of its first point where that is farther away."""
_FIRST, _SHRINKS = 1e3, 0.9
"""Where the cost is looked at first; and the share of a decade's fall that the next must have where
there is no end: the logarithm has 1."""
_ROUNDING, _FALLS = 1e-12, 4
"""Share of a cost that is rounding, and falls one after another that are none."""
_BEFORE, _LEFT = 0.9, 1e-5
"""Where so small a share of a fall is left at this share of the way to where the cost is flat, it
only rounds to flat: exponentials do, hinges do not."""
_DISTANT, _FAR = 10.0, 1e6
"""Sizes from which on rays from the start count too, and a solver's iterates have run away."""
_REMEDY = ": add a bound, or a cost on it"
_FEASIBLE = 1e-6
_SINGLES, _PAIRED = 100, 6
"""Variables up to which each is moved alone, and inputs up to which each two are."""


def describe_endless_ray(rays: Iterable[Ray], best: float, least: float = 0.0) -> str:
    """Sentence on the first ray along which the cost falls for ever, or "".

    ``best`` is the cost of the answer, and a change below ``least`` is none.
    """
    for along, cost, reach in rays:
        if how := describe_fall(cost, reach, best, least):
            return f"the cost {how.format(along)}{_REMEDY}"
    return ""


def describe_fall(cost: Callable[[float], float], reach: float, best: float, least: float) -> str:
    """How ``cost(t)`` falls: without end, towards what no point attains, or "" for neither.

    Without end: over the last three decades by no less in each. Never attained: it does not rise,
    though it falls by less and less, as ``exp(-t)`` does. Either ends no higher than ``best``.
    """
    times = np.concatenate([[0.0], _NEAR, max(reach, 1.0) * _DECADES])
    # Most rays end here: the cost is higher far away.
    if not cost(max(reach, 1.0) * _FIRST) <= best:
        return ""
    costs = np.array([cost(t) for t in times])
    if not costs[-1] < min(costs[0], np.nextafter(best, np.inf)):
        return ""
    steps, size = np.diff(costs), np.abs(costs)
    rounding, last = least + _ROUNDING * np.fmax(size[1:], size[:-1]), -steps[-3:]
    if np.all(last > rounding[-3:]) and np.all(last[1:] > _SHRINKS * last[:-1]):
        return "falls without end along {}"
    falls = int(np.argmin([*(steps < -rounding), False]))
    if falls < _FALLS or not np.all(steps <= rounding):
        return ""
    near, flat = 0.0, times[-1]
    while steps[-1] >= -rounding[-1] and flat - near > _FEASIBLE * flat:
        middle = (near + flat) / 2
        near, flat = (near, middle) if cost(middle) <= costs[-1] else (middle, flat)
    left = cost(_BEFORE * flat) - costs[-1]
    if flat < times[-1] and left > _LEFT * (costs[0] - costs[-1]):
        return ""
    return "keeps falling along {} towards a value that no point attains"


def unbounded_inputs(evaluation: Evaluation, step: Step, plan: Rollout) -> str:
    """Sentence on inputs without bounds along which the plan's cost falls for ever, or ""."""
    rays = _input_rays(evaluation, step, plan, _cost_of_inputs(evaluation))
    return describe_endless_ray(rays, plan.cost, 1e-3 * _ROUNDING * evaluation.problem.scales.cost)


def _cost_of_inputs(evaluation: Evaluation) -> Callable[[np.ndarray], float] | None:
    """What inputs (N, nu) cost by themselves, where no state or impulse can lower that; or None."""
    problem = evaluation.problem
    system, p = problem.system, problem.parameters
    du = ca.SX.sym("du", system.nu) if problem.du is None else problem.du
    costs = [problem.stage_cost, problem.terminal_cost]
    stage, terminal = ca.substitute(costs, [p.vector], [ca.DM(evaluation.p)])
    rest, of_inputs = split_constant(stage, ca.vertcat(system.x, system.lam))
    if min(least_value(rest), least_value(terminal)) < 0:
        return None
    each = ca.Function("cost_of_inputs", [system.u, du], [of_inputs])
    before = evaluation.limits.u_before
    return lambda u: float(np.sum(each(u.T, np.diff(u, axis=0, prepend=before[None]).T)))


def runaway_inputs(problem: Problem, u: np.ndarray) -> str:
    """Sentence on inputs (S, N, nu) that ended a million sizes away, or ""."""
    far = np.abs(np.nan_to_num(u) / problem.scales.u).max(axis=(0, 1)) > _FAR
    gone = [signal.name for signal, away in zip(problem.system.inputs, far, strict=True) if away]
    return f"the solver's iterates ran away along {' and '.join(gone)}{_REMEDY}" if gone else ""


def _input_rays(
    evaluation: Evaluation,
    step: Step,
    plan: Rollout,
    least: Callable[[np.ndarray], float] | None,
) -> Iterator[Ray]:
    """Inputs without bounds, alone, by twos, and all as in the plan, along the whole horizon.

    They are rolled out under the law, from the plan and, where that is distant, from their guess;
    not where what the inputs cost by themselves, ``least``, is more than the plan.
    """
    problem, limits = evaluation.problem, evaluation.limits
    sizes, low, high = problem.scales.u, np.isfinite(limits.u_lower), np.isfinite(limits.u_upper)
    free = np.flatnonzero(~(low & high))
    planned, guess = np.nan_to_num(plan.u.mean(axis=0)), evaluation.initial_guess[1]
    names = [signal.name for signal in problem.system.inputs]
    patterns = [*np.eye(free.size), *-np.eye(free.size)]
    if free.size <= _PAIRED:
        patterns = [s for s in product((0, 1, -1), repeat=free.size) if 0 < np.abs(s).sum() <= 2]
    ways = [np.zeros_like(planned) for _ in range(len(patterns) + 1)]
    for way, pattern in zip(ways, patterns, strict=False):
        way[:, free] = pattern * sizes[free]
    largest = np.abs(planned / sizes)[:, free].max(initial=0.0)
    ways[-1][:, free] = planned[:, free] / max(largest, 1.0)
    for way in ways:
        moved = np.any(way != 0, axis=0)
        if not moved.any() or np.any((way > 0) & high | (way < 0) & low):
            continue
        along = " and ".join(names[i] for i in np.flatnonzero(moved))
        reach = float(np.abs(planned / sizes)[:, moved].max())
        # The other inputs stay as planned: with those of the guess no ray ends below the plan.
        begun = np.where(moved, guess, planned)
        for base in (planned, begun) if reach > _DISTANT else (planned,):
            if least is not None and least(base + max(reach, 1.0) * _FIRST * way) > plan.cost:
                continue
            yield along, partial(_rolled, evaluation, step, plan.x[:, 0], base, way), reach


def _rolled(evaluation: Evaluation, step: Step, x0: np.ndarray, base: np.ndarray, way: np.ndarray, t: float) -> float:
    """Cost of inputs ``base + t way`` (N, nu) from x0 (S, nx); NaN where not feasible."""
    rolled, unsolved = roll_on(evaluation, (base + t * way)[None], step, x0)
    broken = broken_constraints(evaluation, rolled)
    kept = unsolved is None and all(part.share <= CONSTRAINT_SHARE for part in broken)
    return rolled.cost if kept else np.nan


def unbounded_variables(
    program: Program,
    p: np.ndarray,
    bounds: dict[str, np.ndarray],
    answer: np.ndarray,
    start: np.ndarray | None = None,
) -> str:
    """Sentence on variables along which the cost falls for ever, or "".

    Straight rays from the ``answer`` (n,) and, where that is distant or not feasible, from the
    ``start`` (n,), by default the answer.
    """
    model = linear_model(program, answer, p, bounds)
    best = _cost_at(program, model, p, bounds, answer, 0 * answer, 0.0)
    start = answer if start is None else start
    distant = np.abs((answer - start) / program.sizes(start)).max(initial=0.0) > _DISTANT
    bases = [answer, start] if distant or np.isnan(best) else [answer]
    rays = (ray for base in bases for ray in _rays(program, base, p, bounds))
    return describe_endless_ray(rays, float(np.nan_to_num(best, nan=np.inf)))


def _rays(program: Program, x: np.ndarray, p: np.ndarray, bounds: dict[str, np.ndarray]) -> Iterator[Ray]:
    """Down the cost's gradient, away from zero, and along each variable of a small program."""
    model = linear_model(program, x, p, bounds)
    ways = [-model.cost, x / model.sizes] if model.finite else []
    if x.size <= _SINGLES and model.finite:
        ways += [*np.eye(x.size)[np.isinf(model.upper)], *-np.eye(x.size)[np.isinf(model.lower)]]
    for wanted in ways:
        way = recession_direction(model, wanted)
        if way.any():
            moves = partial(_cost_at, program, model, p, bounds, x, model.sizes * way)
            yield _called(program, way), moves, 1.0


def recession_direction(model: LinearModel, wanted: np.ndarray) -> np.ndarray:
    """Direction (n,) nearest to ``wanted`` that no bound or row ends, its largest entry 1, or 0.

    The smaller member of every pair, or what ``wanted`` opens less, stays zero; rows and bounds
    that would be met are held.
    """
    import scipy.sparse as sp
    import scipy.sparse.linalg as sla

    ends = (model.row_lower, model.row_upper, model.lower, model.upper)
    below, above, lower, upper = (np.isfinite(end) for end in ends)
    rows, held, (first, second) = below & above, lower & upper, model.pairs
    opening = model.members[0] - model.members[1]
    opening = np.where(np.abs(opening) > _FEASIBLE, opening, wanted[first] - wanted[second])
    held[np.where(opening > 0, second, first)] = True
    for _ in range(8):
        way = np.where(held, 0.0, wanted)
        A: Any = sp.csr_matrix(model.rows[np.flatnonzero(rows)][:, np.flatnonzero(~held)])
        solve = sla.factorized(sp.csc_matrix(A @ A.T + 1e-10 * sp.identity(A.shape[0])))
        for _ in range(3):
            way[~held] -= A.T @ solve(A @ way[~held])
        largest = np.abs(way).max(initial=0.0)
        if not largest > _FEASIBLE * np.abs(wanted).max(initial=0.0):
            break
        way = np.where(np.abs(way) < 1e-9 * largest, 0.0, way / largest)
        moved = model.rows @ way
        met = ~rows & ((below & (moved < -1e-9)) | (above & (moved > 1e-9)))
        stopped = ~held & ((lower & (way < 0)) | (upper & (way > 0)))
        if not (met.any() or stopped.any()):
            return way
        rows, held = rows | met, held | stopped
    return np.zeros(wanted.size)


def _cost_at(
    program: Program,
    model: LinearModel,
    p: np.ndarray,
    bounds: dict[str, np.ndarray],
    base: np.ndarray,
    way: np.ndarray,
    t: float,
) -> float:
    """Cost at ``base + t way``, NaN where a bound, row or pair is broken by more than rounding."""
    x = base + t * way
    cost, g = program.values(x, p)
    size = np.fmax((abs(model.rows) @ np.abs(x / model.sizes)) / model.row_scale, 1.0)
    off = [
        np.maximum(bounds["lbg"] - g, g - bounds["ubg"]) / size,
        np.maximum(bounds["lbx"] - x, x - bounds["ubx"]) / model.sizes,
        np.abs(x[model.pairs]).min(axis=0),
    ]
    return cost if all(np.all(part <= _FEASIBLE) for part in off) else np.nan


def _called(program: Program, way: np.ndarray) -> str:
    """Names of the variables that move the most along a direction, three at most."""
    found = (program.variables.locate(int(i)) for i in np.flatnonzero(np.abs(way) > 0.1))
    called = (b.components[at[-1]] if b.components else b.name for b, at in found)
    return " and ".join(list(dict.fromkeys(called))[:3])
