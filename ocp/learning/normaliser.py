"""Running mean and scale of what a policy sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LEAST_SCALE = 1e-2
"""Observations that vary less than this are not blown up to unit size."""


@dataclass(frozen=True)
class Normaliser:
    """Mean and sum of squares ``m2`` about it, each (n_o,), of ``n`` observations so far.

    A policy sees ``(o - mean) / scale``. Before the second observation the scale is 1.
    """

    n: float
    mean: np.ndarray
    m2: np.ndarray

    @classmethod
    def identity(cls, size: int) -> Normaliser:
        """Leave observations as they are."""
        return cls(0.0, np.zeros(size), np.zeros(size))

    @property
    def scale(self) -> np.ndarray:
        """Standard deviation, (n_o,), at least ``LEAST_SCALE``."""
        if self.n < 2:
            return np.ones_like(self.m2)
        return np.maximum(np.sqrt(self.m2 / self.n), LEAST_SCALE)

    def after(self, observations: np.ndarray) -> Normaliser:
        """With ``observations`` (n, n_o) added (Chan, Golub and LeVeque)."""
        n = len(observations)
        if not n:
            return self
        mean = observations.mean(axis=0)
        m2 = ((observations - mean) ** 2).sum(axis=0)
        total, off = self.n + n, mean - self.mean
        return Normaliser(
            total, self.mean + off * n / total, self.m2 + m2 + off**2 * self.n * n / total
        )

    def arrays(self) -> dict[str, np.ndarray]:
        """As a checkpoint holds it."""
        return {"seen.n": np.array(self.n), "seen.mean": self.mean, "seen.m2": self.m2}

    @classmethod
    def of(cls, state: dict[str, np.ndarray]) -> Normaliser:
        """Out of a state that holds :meth:`arrays`."""
        return cls(float(state["seen.n"]), state["seen.mean"], state["seen.m2"])
