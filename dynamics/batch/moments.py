"""Mean and second moment of many samples, merged from chunks in a fixed order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Moments:
    """What is kept of n samples of a vector: `n`, `mean` and `m2 = sum (value - mean)^2`.

    `variance` is that of one sample, `standard_error` that of the mean; both need two samples and
    raise `ValueError` with fewer.
    """

    n: int
    mean: np.ndarray
    m2: np.ndarray

    @property
    def variance(self) -> np.ndarray:
        """Unbiased variance of one sample, m2 / (n - 1)."""
        if self.n < 2:
            raise ValueError(f"a variance needs at least 2 finite samples, there are {self.n}")
        return self.m2 / (self.n - 1)

    @property
    def standard_error(self) -> np.ndarray:
        """Standard deviation of the mean, sqrt(variance / n)."""
        return np.sqrt(self.variance / self.n)

    def merged(self, other: Moments) -> Moments:
        """Moments of both sets of samples together (Chan, Golub, LeVeque)."""
        n, mean, m2 = _merge(
            (np.array(self.n), self.mean, self.m2), (np.array(other.n), other.mean, other.m2)
        )
        return Moments(int(n), mean, m2)


def merge_chunks(n: np.ndarray, mean: np.ndarray, m2: np.ndarray) -> Moments:
    """Merge chunks `n` (c,), `mean` and `m2` (c, size) by a tree over neighbours.

    The tree depends on c alone, and so do the rounding errors.
    """
    size = mean.shape[1]
    while len(n) > 1:
        if len(n) % 2:
            n = np.append(n, 0)
            mean, m2 = (np.vstack((a, np.zeros((1, size)))) for a in (mean, m2))
        n, mean, m2 = _merge((n[::2], mean[::2], m2[::2]), (n[1::2], mean[1::2], m2[1::2]))
    if not len(n):
        return Moments(0, np.zeros(size), np.zeros(size))
    return Moments(int(n[0]), mean[0], m2[0])


Triple = tuple[np.ndarray, np.ndarray, np.ndarray]


def _merge(left: Triple, right: Triple) -> Triple:
    total = left[0] + right[0]
    share = (right[0] / np.maximum(total, 1))[..., None]
    difference = right[1] - left[1]
    mean = left[1] + difference * share
    m2 = left[2] + right[2] + difference**2 * share * left[0][..., None]
    return total, mean, m2
