"""Short rollouts of a learned model that branch off from states that were seen."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ocp.learning.buffer import COLUMNS, Buffer
from ocp.learning.explorer import Explorer

ChooseInputs = Callable[[np.ndarray, int], np.ndarray]
"""Maps states (n, nx) and the step's number to inputs (n, nu)."""

PredictNext = Callable[[np.ndarray, np.ndarray, int], np.ndarray]
"""Maps states (n, nx), inputs (n, nu) and the step's number to next states (n, nx)."""


def branch_rollouts(
    explorer: Explorer, starts: np.ndarray, length: int, choose: ChooseInputs, predict: PredictNext
) -> Buffer:
    """Transitions of the model: ``length`` steps from each of ``starts`` (n, nx), step after step.

    A branch stops at a state where the task ends, and before one that is not finite. All branches
    are computed at every step, whichever have stopped, so that shapes do not change.
    """
    x, alive = starts, np.ones(len(starts), dtype=bool)
    parts: dict[str, list[np.ndarray]] = {name: [] for name in COLUMNS}
    for step in range(length):
        u = choose(x, step)
        x_next = predict(x, u, step)
        alive = alive & np.isfinite(x_next).all(axis=1)
        for name, rows in zip(COLUMNS, (x, u, x_next), strict=True):
            parts[name].append(rows[alive])
        x = np.where(alive[:, None], x_next, starts)
        alive = alive & ~explorer.ended(x)
    return Buffer(*(np.concatenate(parts[name]) for name in COLUMNS))


def branch_length(k: int, first: int, last: int, grown_at: int) -> int:
    """Steps of a branch in iteration ``k``: from ``first`` linearly to ``last`` at ``grown_at``."""
    share = min(1.0, k / max(grown_at, 1))
    return round(first + share * (last - first))
