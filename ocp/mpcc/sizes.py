"""Sizes of a complementarity problem's variables, from bounds, start and derivatives."""

from __future__ import annotations

import numpy as np

from ocp.programs.program import PENALTY, RELAXATION, Program

_ROUNDS = 3
"""Passes in which sizes are carried over from variable to variable through the rows."""


def variable_sizes(program: Program, start: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Derive the size of every variable (n,) from ``start`` (n,); NaN where nothing tells.

    The largest of: its value at the start, half the distance of its bounds or the distance of its
    only bound, and one Newton step of the cost. A variable without any of these has the smallest
    step that meets a row which the start violates, and else the smallest that changes a row as much
    as the variables do whose sizes are known.
    """
    values = {PENALTY: 0.0, RELAXATION: 0.0}
    bounds = program.bounds(values)
    slope, g, jacobian = program.slopes(start, p)
    curvature = program.bend(start, p, np.zeros(program.m), np.ones(program.n)).diagonal()
    with np.errstate(divide="ignore", invalid="ignore"):
        newton = np.abs(slope / curvature)
    candidates = [np.abs(start), _bound_distances(start, bounds["lbx"], bounds["ubx"]),
                  np.where(curvature > 0, newton, 0.0)]  # fmt: skip
    sizes = np.max(np.nan_to_num(candidates, posinf=0.0), axis=0)
    change = abs(jacobian).tocsc()
    violation = np.maximum(np.maximum(bounds["lbg"] - g, g - bounds["ubg"]), 0.0)
    sizes = _carried(sizes, change, np.nan_to_num(violation, posinf=0.0))
    for _ in range(_ROUNDS):
        sizes = _carried(
            sizes, change, change.multiply(sizes[None, :]).max(axis=1).toarray().ravel()
        )
    return np.where(sizes > 0, sizes, np.nan)


def _bound_distances(start: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    width = np.where(np.isfinite(upper - lower), (upper - lower) / 2, 0.0)
    ends = [np.where(np.isfinite(end), np.abs(end - start), 0.0) for end in (lower, upper)]
    return np.where(width > 0, width, np.max(ends, axis=0))


def _carried(sizes: np.ndarray, change: object, rows: np.ndarray) -> np.ndarray:
    """Give variables without a size the smallest one that changes a row by ``rows`` (m,)."""
    by_row = change.tocoo()  # pyright: ignore[reportAttributeAccessIssue]
    usable = (by_row.data > 0) & (rows[by_row.row] > 0)
    steps = np.full(sizes.size, np.inf)
    ratio = rows[by_row.row[usable]] / by_row.data[usable]
    np.minimum.at(steps, by_row.col[usable], ratio)
    return np.where((sizes > 0) | ~np.isfinite(steps), sizes, steps)
