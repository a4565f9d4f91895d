"""Characteristic sizes of the variables of a complementarity problem, from bounds, start and derivatives."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ocp.programs.program import PENALTY, RELAXATION, Program

if TYPE_CHECKING:
    import scipy.sparse as sp

ROW_ROUNDING = 1e-8
"""Violation of a row, relative to its change by known sizes, below which it counts as a rounding error."""
_ROUNDS = 3
"""Number of passes that derive sizes of variables from sizes of other variables in the same rows."""


_STEEP = 1e3
"""Multiple of the median change of the cost above which a variable at a bound gets a small size."""


def variable_sizes(program: Program, start: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Return the size of every variable (n,), derived at ``start`` (n,); NaN if nothing determines it.

    It is the maximum of the variable's value at the start, half the distance between its bounds or the
    distance from its only bound, and one Newton step of the cost. A variable without any of these has
    the smallest step that satisfies a row violated at the start, else the smallest step that changes a row as
    much as other variables do, else the step that changes the cost as much as the steepest variable does.
    The step determined from the rows, at most 1, is a lower limit of every size, so that sizes are not small if
    the start is zero or optimal up to rounding errors. Only a variable at a bound along which the cost is steep
    has a small size.
    """
    bounds = program.bounds({PENALTY: 0.0, RELAXATION: 0.0})
    slope, g, jacobian = program.first_derivatives(start, p)
    curvature = program.scaled_hessian(start, p, np.zeros(program.m), np.ones(program.n)).diagonal()
    with np.errstate(divide="ignore", invalid="ignore"):
        newton = np.abs(slope / curvature)
    candidates = [
        np.abs(start),
        _bound_distances(start, bounds["lbx"], bounds["ubx"]),
        np.where(curvature > 0, newton, 0.0),
    ]
    sizes = np.max(np.nan_to_num(candidates, posinf=0.0), axis=0)
    typical = np.max(np.abs(slope) * sizes + np.abs(curvature) * sizes**2 / 2, initial=0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        curvature_steps = np.where(curvature > 0, np.sqrt(2 * typical / curvature), np.nan)
    entries = abs(jacobian).tocoo()
    violation = np.maximum(np.maximum(bounds["lbg"] - g, g - bounds["ubg"]), 0.0)
    row_sizes = abs(jacobian) @ sizes
    violation = np.where(violation > ROW_ROUNDING * row_sizes, violation, 0.0)
    violation = np.nan_to_num(violation, posinf=0.0)
    restoring_steps = _smallest_steps(entries, program.n, violation[entries.row])
    sizes = np.where(sizes > 0, sizes, restoring_steps)
    for _ in range(_ROUNDS):
        changes = _changes_by_others(entries, program.m, sizes)
        other_steps = _smallest_steps(entries, program.n, changes)
        sizes = np.where(sizes > 0, np.maximum(sizes, np.minimum(other_steps, 1.0)), other_steps)
    sizes = np.where(sizes > 0, sizes, curvature_steps)
    return np.fmin(np.where(sizes > 0, sizes, np.nan), _steep_limits(slope, sizes, start, bounds))


def _steep_limits(slope: np.ndarray, sizes: np.ndarray, start: np.ndarray, bounds: dict[str, np.ndarray]) -> np.ndarray:
    """Return (n,), for steep variables at a bound, the step that changes the cost by the median; else NaN."""
    change = np.abs(slope) * np.where(sizes > 0, sizes, 1.0)
    is_held = np.where(slope > 0, start <= bounds["lbx"], start >= bounds["ubx"])
    free_changes = change[~is_held & (change > 0)]
    if not free_changes.size:
        return np.full(slope.size, np.nan)
    typical = np.median(free_changes)
    steep = is_held & (change > _STEEP * typical)
    return np.where(steep, typical / np.where(steep, np.abs(slope), 1.0), np.nan)


def _bound_distances(start: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    width = np.where(np.isfinite(upper - lower), (upper - lower) / 2, 0.0)
    distances = [np.where(np.isfinite(bound), np.abs(bound - start), 0.0) for bound in (lower, upper)]
    return np.where(width > 0, width, np.max(distances, axis=0))


def _changes_by_others(entries: sp.coo_matrix, m: int, sizes: np.ndarray) -> np.ndarray:
    """Return for every entry (nnz,) of m rows the largest change of its row by another variable."""
    change = entries.data * sizes[entries.col]
    largest, second = np.zeros(m), np.zeros(m)
    np.maximum.at(largest, entries.row, change)
    at_largest = change >= largest[entries.row]
    np.maximum.at(second, entries.row, np.where(at_largest, 0.0, change))
    count = np.bincount(entries.row, at_largest, m)
    second = np.where(count > 1, largest, second)
    return np.where(at_largest, second[entries.row], largest[entries.row])


def _smallest_steps(entries: sp.coo_matrix, n: int, changes: np.ndarray) -> np.ndarray:
    """Return the smallest step (n,) of each variable that changes a row by ``changes`` (nnz,); 0 if none."""
    steps = np.full(n, np.inf)
    usable = (entries.data > 0) & (changes > 0)
    np.minimum.at(steps, entries.col[usable], changes[usable] / entries.data[usable])
    return np.where(np.isfinite(steps), steps, 0.0)
