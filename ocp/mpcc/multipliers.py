"""Multipliers of a complementarity problem at a feasible point, and derivatives of solutions by its parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ocp.judge.certificate import fit_multipliers
from ocp.judge.kkt import regular_curve
from ocp.judge.lpec import LinearModel
from ocp.judge.sensitivity import PARAMETER_STEP, check_regular, check_strict, cost_slope
from ocp.mpcc.programs import MPCC, BoundsAt, MPCCProgram
from ocp.programs.program import PENALTY, RELAXATION
from ocp.programs.solver import Point


@dataclass(frozen=True)
class Multipliers:
    """Multipliers in the sign convention of CasADi: ``x`` (n,) of bounds, ``g`` (m,) of rows, ``G`` and ``H`` (k,).

    Stationary points satisfy ``df/dx + g' dg/dx + x + G' dG/dx + H' dH/dx = 0``. Multipliers of lower
    limits are negative or zero; those of the member of a pair that is held at zero have either sign
    while the other member is positive.
    """

    x: np.ndarray
    g: np.ndarray
    G: np.ndarray
    H: np.ndarray


def multipliers_at(
    program: MPCCProgram, x: np.ndarray, p: np.ndarray, bounds: dict[str, np.ndarray], rows: np.ndarray | None
) -> Multipliers:
    """Return the multipliers at a feasible point x (n,); multipliers ``rows`` (m,) of g are fitted if None."""
    if rows is None:
        rows = fit_multipliers(LinearModel.at(program, x, p, bounds))
    gradient, _, jacobian = program.first_derivatives(x, p)
    slopes = -(gradient + jacobian.T @ rows)
    # An entry of x that is a side of a pair is held at zero by the pair, and elsewhere by its bounds.
    near_zero = x[program.pairs] < bounds["ubx"][program.pairs] - x[program.pairs]
    pair_multipliers = np.where(near_zero, slopes[program.pairs], 0.0)
    slopes[program.pairs[near_zero]] = 0.0
    n = program.mpcc.x.numel()
    return Multipliers(slopes[:n], rows[program.constraints["g"].index.ravel()], *pair_multipliers)


def sensitivities(
    mpcc: MPCC, x: np.ndarray, p: np.ndarray, bounds_at: BoundsAt | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return ``dx/dp`` (n, n_p) and ``df/dp`` (n_p,) at a solution x (n,), with its active set held fixed.

    ``bounds_at`` is a function from p to lower and upper bounds of x and of g, where these depend on p.
    Each column is one linear solve with the KKT matrix of the branch (:mod:`ocp.judge.sensitivity`).

    Raises :class:`~ocp.errors.InputError` if the solution has no derivative, since complementarity is
    not strict or the reduced KKT matrix is singular along a direction that moves x.
    """
    program = MPCCProgram(mpcc, "none", p, x, bounds_at)
    point, n = Point(program.extended(x)), mpcc.x.numel()
    dx, df = np.zeros((n, p.size)), np.zeros(p.size)
    for i, value in enumerate(p):
        name, unit = f"p[{i}]", abs(float(value)) or 1.0
        values = {PENALTY: 0.0, RELAXATION: 0.0, name: float(value)}
        curve, v = regular_curve(program, point, values, name, unit)
        check_regular(curve, v, lambda moved, curve=curve: curve.primal_dual(moved)[0][:n])
        t = curve.tangent(v)
        check_strict(curve, v, t)
        forward, backward = (curve.primal_dual(v + s * PARAMETER_STEP * t)[0][:n] for s in (1, -1))
        dx[:, i] = (forward - backward) / (2 * PARAMETER_STEP * unit)
        df[i] = cost_slope(curve, v)
    return dx, df
