"""The scales in which data are compared, and in which noise is measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Normalisation:
    """``(a - shift) / scale`` per coordinate, shift and scale (n,) in the coordinates' own units.

    Noise of width sigma is ``sigma scale`` in those units: metres and radians have no common one.
    """

    shift: np.ndarray
    scale: np.ndarray

    @classmethod
    def of(cls, rows: np.ndarray, names: Sequence[str]) -> Normalisation:
        """Mean and standard deviation of every column of ``rows`` (n_samples, n).

        Raises ``ValueError`` that names a column which does not vary.
        """
        scale = rows.std(axis=0)
        size = np.abs(rows).max(axis=0, initial=0.0)
        constant = [name for name, s, a in zip(names, scale, size, strict=True) if s <= 1e-12 * a]
        if constant:
            raise ValueError(
                f"data: {', '.join(constant)} never varies, so nothing can be learned from it; vary"
                " it in the data or leave it out"
            )
        return cls(rows.mean(axis=0), scale)

    def normalised(self, rows: np.ndarray) -> np.ndarray:
        """From the coordinates' units, (..., n)."""
        return (rows - self.shift) / self.scale

    def physical(self, rows: np.ndarray) -> np.ndarray:
        """Back to the coordinates' units, (..., n)."""
        return rows * self.scale + self.shift
