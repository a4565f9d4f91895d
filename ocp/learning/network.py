"""A policy's network: normalised observations, first weights, derivatives of the mean action."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dynamics.batch import DensePolicy, RolloutPolicy

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


def first_weights(sizes: Sequence[int], last: float, rng: np.random.Generator) -> np.ndarray:
    """Normal weights of deviation 1 / sqrt(fan in), the last layer's ``last`` times that; b = 0.

    ``sizes`` are the lengths of the observations, the hidden layers and the action.
    """
    parts = []
    for layer, (fan_in, fan_out) in enumerate(pairwise(sizes)):
        size = last if layer == len(sizes) - 2 else 1.0
        parts += [
            rng.standard_normal(fan_in * fan_out) * size / np.sqrt(fan_in),
            np.zeros(fan_out),
        ]
    return np.concatenate(parts)


def vjp(
    policy: RolloutPolicy, theta: np.ndarray, seen: np.ndarray, bar: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """``bar' da/dtheta`` (n, n_theta) and ``bar' da/do`` (n, n_o) at normalised observations.

    ``seen`` is (n, n_o), ``bar`` (n, n_a); a policy without observations is its own parameters.
    """
    if not isinstance(policy, DensePolicy):
        return bar, np.zeros_like(seen)
    layers, values = policy.layers(theta), [seen]
    for weights, offsets in layers[:-1]:
        values.append(np.tanh(values[-1] @ weights.T + offsets))
    parts: list[np.ndarray] = []
    for (weights, _), before in zip(reversed(layers), reversed(values), strict=True):
        outer = bar[:, :, None] * before[:, None, :]
        parts = [outer.reshape(len(bar), weights.size), bar, *parts]
        bar = bar @ weights
        if before is not seen:
            bar = bar * (1 - before**2)
    return np.hstack(parts), bar


def renormalised(
    policy: RolloutPolicy, theta: np.ndarray, before: Normaliser, after: Normaliser
) -> np.ndarray:
    """Parameters of the same policy where ``after`` normalises what ``before`` did.

    ``W' = W s'/s`` and ``b' = b + W (m' - m)/s`` of the first layer, with the means m and scales s.
    """
    if not isinstance(policy, DensePolicy):
        return theta
    moved = theta.copy()
    weights, offsets = policy.layers(moved)[0]
    offsets += weights @ ((after.mean - before.mean) / before.scale)
    weights *= after.scale / before.scale
    return moved
