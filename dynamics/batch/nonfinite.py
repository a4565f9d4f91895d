"""Samples that gave NaN or infinity: counted, and named by their index."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


class BatchWarning(UserWarning):
    """What a user of batched evaluation should know: a fallback, or non-finite samples."""


@dataclass(frozen=True)
class NonFinite:
    """The samples of one evaluation with a NaN or an infinity: how many, and which.

    `indices` holds the sample indices in ascending order. False when there are none.
    """

    count: int = 0
    indices: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    def __bool__(self) -> bool:
        return self.count > 0

    def __str__(self) -> str:
        shown = ", ".join(map(str, self.indices[:5])) + (", ..." if self.count > 5 else "")
        return f"{self.count} non-finite sample{'s' * (self.count != 1)}, at index {shown}"


def non_finite_rows(arrays: list[np.ndarray]) -> NonFinite:
    """Which rows (axis 0) hold a value that is not finite, over arrays of equal length."""
    bad = np.zeros(len(arrays[0]), dtype=bool)
    for array in arrays:
        bad |= ~np.isfinite(array.reshape(len(array), -1)).all(axis=1)
    indices = np.flatnonzero(bad)
    return NonFinite(len(indices), indices)
