"""A policy's weights at first, and derivatives of its mean action at given observations."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from dynamics.batch import DensePolicy, RolloutPolicy
from ocp.learning.normaliser import Normaliser


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
