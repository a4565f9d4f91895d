"""How a solution changes with a parameter: one linear solve on its active set."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ocp.errors import InputError
from ocp.programs.solver import Point, Result, Status
from ocp.stationarity.kkt import KKTCurve, regular
from ocp.transcription.nlp import NLP, trajectories

if TYPE_CHECKING:
    import xarray as xr

_DEGENERATE = 1e-7
"""A slack or multiplier, in characteristic sizes, below which an end is not strictly one or other.
"""
_STILL = 1e-6
"""How fast, per unit, such a slack may grow and still count as staying zero."""
_SINGULAR = 1e-8
_DIFFERENCE = 1e-4


def sensitivity(program: NLP, point: Point, values: dict[str, float], name: str) -> xr.Dataset:
    """Return ``dx/dp``, ``du/dp`` and ``dcost/dp`` for the parameter ``name`` at a solved point.

    On the active set, held, the KKT conditions ``F(z, p) = 0`` are smooth, and ``dz/dp`` solves
    ``F_z dz/dp = -F_p``; bounds and initial data move with p. The cost changes by the partial
    derivative of the Lagrangian (envelope theorem). The point is brought to the KKT conditions by
    Newton's method first. ``x`` (scenario, node, state) and ``u`` (scenario, interval, control) are
    per unit of the parameter; the penalty of gains counts in ``cost``.

    Raises :class:`~ocp.errors.InputError` for an unknown name, and where the solution has no
    derivative: where strict complementarity does not hold, or the reduced KKT matrix is singular.
    """
    import xarray as xr

    if name not in program.names[:-2]:
        listed = ", ".join(program.names[:-2])
        raise InputError(f"there is no parameter {name!r} to differentiate by; there are {listed}")
    curve, v = regular(program, point, values, name, abs(values[name]) or 1.0)
    _check_regular(program, curve, v)
    t = curve.tangent(v)
    _check_strict(curve, v, t)
    ends = [_trajectories(program, curve, v + s * _DIFFERENCE * t) for s in (1, -1)]
    dx, du = ((a - b) / (2 * _DIFFERENCE * curve.unit) for a, b in zip(*ends, strict=True))
    parameter = (program.problem.parameters + program.step.p).get(name)
    system = program.problem.system
    return xr.Dataset(
        {
            "x": (("scenario", "node", "state"), dx),
            "u": (("scenario", "interval", "control"), du),
            "cost": ((), _cost_slope(curve, v)),
        },
        coords={"state": [s.name for s in system.states],
                "control": [s.name for s in system.inputs],
                "state_unit": ("state", [s.unit for s in system.states]),
                "control_unit": ("control", [s.unit for s in system.inputs])},
        attrs={"parameter": name, "per": parameter.unit},
    )  # fmt: skip


def _check_strict(curve: KKTCurve, v: np.ndarray, t: np.ndarray) -> None:
    """Refuse where an end is neither held nor free.

    One whose slack and multiplier are zero, and stay so to first order along the tangent, does no
    harm: held or free the derivative is the same, as long as a pair's held member is pressed.
    """
    step = _DIFFERENCE * t
    margins = curve.margins(v)
    with np.errstate(invalid="ignore"):
        slopes = (curve.margins(v + step) - curve.margins(v - step)) / (2 * _DIFFERENCE)
    degenerate = (margins < _DEGENERATE) & ~((margins > -_DEGENERATE) & (np.abs(slopes) < _STILL))
    if curve.own.size:
        pressed = curve.press(v)[curve.own[::-1]] > _DEGENERATE
        alone = (curve.held.x[curve.own[::-1]] != 0) & (curve.held.x[curve.own] == 0)
        degenerate[curve.own] |= (margins[curve.own] < _DEGENERATE) & alone & ~pressed
    else:
        degenerate[curve.program.pairs] = False
    if degenerate.any():
        name, step, _ = curve.place(int(np.flatnonzero(degenerate)[0]))
        raise InputError(
            f"no derivative by {curve.name}: complementarity is not strict at"
            f" {name!r}, step {step} (slack and multiplier are both zero)"
        )


def _check_regular(program: NLP, curve: KKTCurve, v: np.ndarray) -> None:
    """Refuse where the reduced KKT matrix takes some direction of states and inputs to nothing."""
    right = np.random.default_rng(0).standard_normal(v.size)
    right[-1] = 0.0
    for _ in range(2):
        right = curve.solve(v, curve.parameter_direction, right)
        right /= np.linalg.norm(right)
    small = np.abs(curve.matrix(v) @ right).max() < _SINGULAR
    moved = np.zeros_like(right)
    moved[: curve.nx] = right[: curve.nx]
    ends = [_trajectories(program, curve, v + s * moved) for s in (1, -1)]
    moves = max(float(np.abs(a - b).max()) for a, b in zip(*ends, strict=True)) > 1e-4
    if not np.all(np.isfinite(right)) or (small and moves):
        raise InputError(
            f"no derivative by {curve.name}: the reduced KKT matrix is singular, the solution can"
            " move along a direction of no curvature"
        )


def _trajectories(program: NLP, curve: KKTCurve, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    point, f, g = curve.result(v)
    found = Result(point, f, g, Status.SOLVED, "", 0, 0.0)
    plan = trajectories(program, found, curve.given(v[-1])[0])
    return plan.x, plan.u


def _cost_slope(curve: KKTCurve, v: np.ndarray) -> float:
    """Partial derivative of the Lagrangian by the parameter, bounds that are held with it."""
    _, y = curve.point(v)
    step, ends = _DIFFERENCE / 10 * curve.parameter_direction, []
    for sign in (1, -1):
        (x, _), (p, bounds) = curve.point(v + sign * step), curve.given(v[-1] + sign * step[-1])
        f, g = curve.program.values(x, p)
        held = np.where(curve.held.g < 0, bounds["lbg"], bounds["ubg"])[curve.acting]
        ends.append(f + float(y[curve.acting] @ (g[curve.acting] - held)))
    return (ends[0] - ends[1]) / (2 * step[-1] * curve.unit)
