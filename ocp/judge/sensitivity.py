"""Derivatives of a solution with respect to a parameter, from one linear solve with its active set."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from ocp.errors import InputError
from ocp.judge.kkt import KKTCurve, regular_curve
from ocp.programs.solver import Point, Result, Status
from ocp.transcription.nlp import NLP, Trajectories, trajectories

if TYPE_CHECKING:
    import xarray as xr

_NOT_STRICT = 1e-7
"""Slack or multiplier, in characteristic sizes, below which an end is neither strictly held nor strictly free."""
_STAYS_ZERO = 1e-6
"""Change of a zero slack or multiplier, per unit of the parameter, that counts as zero."""
_SINGULAR_MATRIX = 1e-8
"""Norm of the KKT matrix times a unit vector below which the matrix is singular."""
_COST_ROUNDING = 1e-12
"""Rounding of a cost, in its natural unit."""
PARAMETER_STEP = 1e-4
"""Step of differences along the tangent, in units of the parameter."""
_SAME_PLAN = 1e-4
"""Change of quantities, such as states and inputs, up to which two solutions count as equal."""
AGREEMENT = 0.1
"""Relative difference up to which the slope of a replay confirms a sensitivity."""
Replay = Callable[[Trajectories, dict[str, float]], Any]
"""Function that replays a plan at parameter values under the referee's model, see :mod:`ocp.judge.referee`."""


def sensitivity(program: NLP, point: Point, values: dict[str, float], replay: Replay, name: str) -> xr.Dataset:
    """Return ``dx/dp``, ``du/dp`` and ``dcost/dp`` for the parameter ``name`` at a solved point.

    With the active set held fixed, the KKT conditions ``F(z, p) = 0`` are smooth, and ``dz/dp`` solves
    ``F_z dz/dp = -F_p``; bounds and initial data move with p. The cost changes by the partial
    derivative of the Lagrangian (envelope theorem). Newton's method first brings the point to the
    KKT conditions. ``x`` (scenario, node, state) and ``u`` (scenario, interval, control) are
    per unit of the parameter; ``cost`` includes the penalty on gains.

    ``cost_referee`` and ``cost_refined`` are central differences of the cost of the plan's inputs or
    policy, moved along the tangent, in the referee's replays at h and at h/4, ``x_refined`` those of
    the states at h/4; NaN without such a replay. If too few steps resolve a stiff contact, these
    slopes are those of the discretisation, not of the physics.

    Raises :class:`~ocp.errors.InputError` for an unknown name, and if the solution has no
    derivative: if strict complementarity does not hold, or the reduced KKT matrix is singular.
    """
    import xarray as xr

    if name not in program.names[:-2]:
        listed = ", ".join(program.names[:-2])
        raise InputError(f"there is no parameter {name!r} to differentiate by; there are {listed}")
    curve, v = regular_curve(program, point, values, name, abs(values[name]) or 1.0)
    check_regular(curve, v, lambda moved_point: _states_and_inputs(program, curve, moved_point))
    t = curve.tangent(v)
    check_strict(curve, v, t)
    ends = [_trajectories(program, curve, v + s * PARAMETER_STEP * t) for s in (1, -1)]
    dx, du = ((getattr(ends[0], key) - getattr(ends[1], key)) / (2 * PARAMETER_STEP * curve.unit) for key in ("x", "u"))
    replayed, refined, x_refined, note = _replayed_slopes(program, curve, v, t, replay)
    parameter = (program.problem.parameters + program.step.p).get(name)
    system = program.problem.system
    return xr.Dataset(
        {
            "x": (("scenario", "node", "state"), dx),
            "u": (("scenario", "interval", "control"), du),
            "cost": ((), cost := cost_slope(curve, v)),
            "cost_referee": ((), replayed),
            "cost_refined": ((), refined),
            "x_refined": (("scenario", "node", "state"), x_refined),
        },
        coords={
            "state": [s.name for s in system.states],
            "control": [s.name for s in system.inputs],
            "state_unit": ("state", [s.unit for s in system.states]),
            "control_unit": ("control", [s.unit for s in system.inputs]),
        },
        attrs={
            "parameter": name,
            "per": parameter.unit,
            "refined_note": note,
            "finding": _finding(curve, cost, replayed, refined),
        },
    )


def _replayed_slopes(
    program: NLP, curve: KKTCurve, v: np.ndarray, t: np.ndarray, replay: Replay
) -> tuple[float, float, np.ndarray, str]:
    """Return the slopes of replays' costs at h and h/4, of x at h/4, and why those at h/4 are missing, or ""."""
    step, replays = PARAMETER_STEP / 10, []
    for sign in (1, -1):
        moved_point = v + sign * step * t
        values = {**curve.values, curve.name: moved_point[-1] * curve.unit}
        replays.append(replay(_trajectories(program, curve, moved_point), values))
    results = [(end.cost, end.refined_cost, end.refined.x if end.refined else np.nan * end.replay.x) for end in replays]
    cost, refined, x = ((a - b) / (2 * step * curve.unit) for a, b in zip(*results, strict=True))
    return cost, refined, x, replays[0].refined_note or replays[1].refined_note


def _finding(curve: KKTCurve, cost: float, replayed: float, refined: float) -> str:
    """Return a clause with the derivatives of the planned cost and of the replayed costs at h and h/4."""
    replayed_slopes = ((replayed, "in the replay"), (refined, "in the replay at h/4"))
    slopes = [f"the sensitivity dcost/d{curve.name} is {cost:.4g}"]
    slopes += [f"{slope:.4g} {replay_name}" for slope, replay_name in replayed_slopes if np.isfinite(slope)]
    tolerance = AGREEMENT * abs(cost) + _COST_ROUNDING * curve.program.natural.f / curve.unit
    differs = np.abs([replayed - cost, refined - cost]) > tolerance
    by_step = "right for the discrete map but not for the physics, since it depends on the step size"
    reason = "it depends on the law" if differs[0] else by_step if differs[1] else ""
    return ", ".join(slopes) + (f": {reason}" if reason else "")


def check_strict(curve: KKTCurve, v: np.ndarray, t: np.ndarray) -> None:
    """Raise InputError if an end is neither strictly held nor strictly free.

    An end whose slack and multiplier are zero, and stay zero to first order along the tangent, is
    allowed: the derivative is the same whether the end is held or free, provided that the held
    member of a pair has a multiplier above zero.
    """
    step = PARAMETER_STEP * t
    margins = curve.margins(v)
    with np.errstate(invalid="ignore"):
        slopes = (curve.margins(v + step) - curve.margins(v - step)) / (2 * PARAMETER_STEP)
    degenerate = (margins < _NOT_STRICT) & ~((margins > -_NOT_STRICT) & (np.abs(slopes) < _STAYS_ZERO))
    if curve.pairs.size:
        pressed = curve.lower_slopes(v)[curve.pairs[::-1]] > _NOT_STRICT
        alone = (curve.held.x[curve.pairs[::-1]] != 0) & (curve.held.x[curve.pairs] == 0)
        degenerate[curve.pairs] |= (margins[curve.pairs] < _NOT_STRICT) & alone & ~pressed
    else:
        degenerate[curve.program.pairs] = False
    if degenerate.any():
        name, step, _ = curve.end_name(int(np.flatnonzero(degenerate)[0]))
        raise InputError(
            f"no derivative by {curve.name}: complementarity is not strict at"
            f" {name!r}, step {step} (slack and multiplier are both zero)"
        )


def _states_and_inputs(program: NLP, curve: KKTCurve, v: np.ndarray) -> np.ndarray:
    plan = _trajectories(program, curve, v)
    return np.concatenate([plan.x.ravel(), plan.u.ravel()])


def check_regular(curve: KKTCurve, v: np.ndarray, quantities: Callable[[np.ndarray], np.ndarray]) -> None:
    """Raise InputError if the reduced KKT matrix is singular along a direction that moves ``quantities(v)`` (k,)."""
    null_vector = np.random.default_rng(0).standard_normal(v.size)
    null_vector[-1] = 0.0
    for _ in range(2):
        null_vector = curve.solve(v, curve.parameter_direction, null_vector)
        null_vector /= np.linalg.norm(null_vector)
    is_singular = np.abs(curve.matrix(v) @ null_vector).max() < _SINGULAR_MATRIX
    direction = np.zeros_like(null_vector)
    direction[: curve.nx] = null_vector[: curve.nx]
    first, second = (quantities(v + s * direction) for s in (1, -1))
    moves = np.abs(first - second).max() > _SAME_PLAN
    if not np.all(np.isfinite(null_vector)) or (is_singular and moves):
        raise InputError(
            f"no derivative by {curve.name}: the reduced KKT matrix is singular, the solution can"
            " move along a direction of no curvature"
        )


def _trajectories(program: NLP, curve: KKTCurve, v: np.ndarray) -> Trajectories:
    point, f, g = curve.solver_point(v)
    result = Result(point, f, g, Status.SOLVED, "", 0, 0.0)
    return trajectories(program, result, curve.problem_data(v[-1])[0])


def cost_slope(curve: KKTCurve, v: np.ndarray) -> float:
    """Return the partial derivative of the Lagrangian with respect to the parameter, held bounds included."""
    _, y = curve.primal_dual(v)
    step, lagrangians = PARAMETER_STEP / 10 * curve.parameter_direction, []
    for sign in (1, -1):
        (x, _), (p, bounds) = curve.primal_dual(v + sign * step), curve.problem_data(v[-1] + sign * step[-1])
        f, g = curve.program.values(x, p)
        held_bounds = np.where(curve.held.g < 0, bounds["lbg"], bounds["ubg"])[curve.acting]
        lagrangians.append(f + curve.program.constant(p) + float(y[curve.acting] @ (g[curve.acting] - held_bounds)))
    return (lagrangians[0] - lagrangians[1]) / (2 * step[-1] * curve.unit)
