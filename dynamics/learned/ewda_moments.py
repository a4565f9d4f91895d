"""What an engine of the weighted average computes, and the engine in NumPy."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

CUTOFF = 1e-25
"""Weights below this share of the heaviest are left out: all of them are less than its rounding."""
_BLOCK = 1 << 22
"""Distances that are held at once."""


@dataclass(frozen=True)
class Cloud:
    """The data in normalised coordinates: z (n, nz), y (n, ny), and the width sigma."""

    z: np.ndarray
    y: np.ndarray
    sigma: float


class Moments(Protocol):
    """Sums over the points, of which c is the nearest to the query q.

    The weights are ``w_i = exp((|q - c|² - |q - z_i|²) / 2 sigma²)``, 1 for c.
    """

    def first(self, q: np.ndarray, *, slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        """Index (nq,) of the nearest point c, and ``sum_i w_i a_i b_i'`` (nq, 1 + ny, 1 or 1 + nz).

        ``a = (1, y_i - y_c)``, ``b = (1, z_i - z_c)``, of which without ``slopes`` only the 1.
        """
        ...

    def second(
        self, q: np.ndarray, mean_z: np.ndarray, mean_y: np.ndarray, weights: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """``sum_i w_i`` (nq,) and ``sum_i w_i s_i d_i d_i'`` (nq, nz, nz), symmetric.

        ``d_i = z_i - z_c - mean_z``, ``s_i = weights_y' (y_i - y_c - mean_y) + weights_last``
        with means (nq, nz), (nq, ny) and weights (nq, ny + 1) of every query.
        """
        ...


@dataclass(frozen=True)
class NumpyMoments:
    """Distances by products of matrices, a block of queries at a time; moments query by query."""

    points: Cloud

    def first(self, q: np.ndarray, *, slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        """As :class:`Moments` says."""
        z, y = self.points.z, self.points.y
        cols = 1 + z.shape[1] if slopes else 1
        nearest = np.empty(len(q), dtype=np.int64)
        sums = np.empty((len(q), 1 + y.shape[1], cols))
        for i, home, near in self._neighbours(q):
            nearest[i] = home
            d, w = self._weights(near, q[i], z[home])
            a = _with_ones(y[near] - y[home]) * w[:, None]
            sums[i] = a.T @ _with_ones(d)[:, :cols]
        return nearest, sums

    def second(
        self, q: np.ndarray, mean_z: np.ndarray, mean_y: np.ndarray, weights: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """As :class:`Moments` says."""
        y, nz = self.points.y, q.shape[1]
        total, sums = np.empty(len(q)), np.empty((len(q), nz, nz))
        for i, home, near in self._neighbours(q):
            d, w = self._weights(near, q[i], self.points.z[home])
            d -= mean_z[i]
            level = (y[near] - y[home] - mean_y[i]) @ weights[i, :-1] + weights[i, -1]
            total[i] = w.sum()
            sums[i] = (d * (w * level)[:, None]).T @ d
        # A product with scaled rows is symmetric only up to its rounding.
        return total, 0.5 * (sums + sums.transpose(0, 2, 1))

    def _weights(
        self, near: np.ndarray, q: np.ndarray, c: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        d = self.points.z[near] - c
        exponent = -np.einsum("ik,ik->i", d, d + 2 * (c - q)) / (2 * self.points.sigma**2)
        # Above 0 only by rounding, which far out is of any size: there the neighbours tie.
        return d, np.exp(np.minimum(exponent, 64.0))

    def _neighbours(self, q: np.ndarray) -> Iterator[tuple[int, int, np.ndarray]]:
        """Every query's number, its nearest point, and the points whose weight counts."""
        z = self.points.z
        square = np.einsum("ik,ik->i", z, z)
        reach = np.abs(z).max(axis=0).sum()
        cutoff = 2 * self.points.sigma**2 * -np.log(CUTOFF)
        block = max(1, _BLOCK // len(z))
        for begin in range(0, len(q), block):
            part = q[begin : begin + block]
            distance = square - 2 * (part @ z.T)
            size = np.abs(part).sum(axis=1)
            lost = (z.shape[1] + 4) * 2.0**-51 * reach * (reach + 2 * size)
            for i, row in enumerate(distance):
                home = int(np.argmin(row))
                yield begin + i, home, np.flatnonzero(row <= row[home] + cutoff + lost[i])


def _with_ones(rows: np.ndarray) -> np.ndarray:
    return np.hstack((np.ones((len(rows), 1)), rows))
