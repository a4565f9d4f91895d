"""Running mean and spread of what a policy has seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ocp.learning.rollouts import Normaliser

LEAST_SCALE = 1e-2
"""Observations that vary less than this are not blown up to unit size."""


@dataclass(frozen=True)
class Seen:
    """Mean and sum of squares ``m2`` about it, each (n_o,), of ``n`` observations so far."""

    n: float
    mean: np.ndarray
    m2: np.ndarray

    @classmethod
    def nothing(cls, size: int) -> Seen:
        """No observation yet."""
        return cls(0.0, np.zeros(size), np.zeros(size))

    @property
    def normaliser(self) -> Normaliser:
        """Mean and standard deviation, at least ``LEAST_SCALE``; 1 before the second sight."""
        if self.n < 2:
            return Normaliser(self.mean, np.ones_like(self.mean))
        return Normaliser(self.mean, np.maximum(np.sqrt(self.m2 / self.n), LEAST_SCALE))

    def after(self, observations: np.ndarray) -> Seen:
        """With ``observations`` (n, n_o) added (Chan, Golub and LeVeque)."""
        n = len(observations)
        if not n:
            return self
        mean = observations.mean(axis=0)
        m2 = ((observations - mean) ** 2).sum(axis=0)
        total, off = self.n + n, mean - self.mean
        joined = self.m2 + m2 + off**2 * self.n * n / total
        return Seen(total, self.mean + off * n / total, joined)

    def arrays(self) -> dict[str, np.ndarray]:
        """As a checkpoint holds it."""
        return {"seen.n": np.array(self.n), "seen.mean": self.mean, "seen.m2": self.m2}

    @classmethod
    def of(cls, state: dict[str, np.ndarray]) -> Seen:
        """Out of a state that holds :meth:`arrays`."""
        return cls(float(state["seen.n"]), state["seen.mean"], state["seen.m2"])
