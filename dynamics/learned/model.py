"""What a model of a step is: a map with two derivatives, over many queries at once."""

from __future__ import annotations

from typing import Protocol

import numpy as np


class LearnedMap(Protocol):
    """``y = g(z)``, z = (x, u) (n_in,), y (n_out,) the next state and, after it, whatever else.

    Everything is in physical units and float64, one row a query.
    """

    @property
    def n_in(self) -> int:
        """Entries of z."""
        ...

    @property
    def n_out(self) -> int:
        """Entries of y."""
        ...

    def values(self, z: np.ndarray) -> np.ndarray:
        """``y`` (n, n_out) at ``z`` (n, n_in)."""
        ...

    def jacobians(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``y`` (n, n_out) and ``dy/dz`` (n, n_out, n_in)."""
        ...

    def curvatures(self, z: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """``sum_i weights_i d²y_i/dz²`` (n, n_in, n_in), symmetric, for ``weights`` (n, n_out)."""
        ...
