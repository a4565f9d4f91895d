"""Derivatives of a policy's mean action, for samples at given observations."""

from __future__ import annotations

import numpy as np

from dynamics.batch import DensePolicy, RolloutPolicy
from ocp.learning.normaliser import Normaliser


def pulled_back(
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
        parts = [outer.reshape(len(bar), -1), bar, *parts]
        bar = bar @ weights
        if before is not seen:
            bar = bar * (1 - before**2)
    return np.hstack(parts), bar


def rebased(
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
