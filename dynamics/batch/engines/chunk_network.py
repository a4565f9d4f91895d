"""Dense layers of a policy over chunks of samples, and their transposed derivatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Protocol

import casadi as ca
import numpy as np

from dynamics.batch.graphs.step_graphs import Layers

Array = np.ndarray


class Kernel(Protocol):
    """Evaluates one short graph over samples: arrays `(nnz, m)` in and out, samples last."""

    def run(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Fill `outputs`; an input of shape `(nnz, 1)` is shared by all samples."""
        ...


class ChunkNetwork:
    """Mean actions `a = W_L tanh(...) + b_L` of the observation of a state, samples last.

    theta is (n_weights, m), or (n_weights, 1) where all samples share it.
    """

    def __init__(self, layers: Layers, make: Callable[[ca.Function], Kernel]) -> None:
        self._layers = layers
        self._observe, self._back = make(layers.observe), make(layers.observe_adjoint)

    def actions(self, theta: Array, x: Array, p: Array) -> Array:
        """Mean actions (n_a, m) at states x (nx, m)."""
        return self._values(theta, x, p)[-1]

    def pulled_back(self, theta: Array, x: Array, p: Array, abar: Array, total: Array) -> Array:
        """Add `D_theta a' abar` to `total` (n_weights, m), and return `D_x a' abar` (nx, m)."""
        values, places = self._values(theta, x, p), self._places()
        bar = abar
        for k in reversed(range(len(places))):
            middle, end, before, after = places[k]
            product = bar[:, None] * values[k][None]
            total[middle - before * after : middle] += product.reshape(before * after, -1)
            total[middle:end] += bar
            weights = theta[middle - before * after : middle].reshape(after, before, -1)
            bar = _summed(weights, bar, (0, 2))
            if k:
                bar *= 1.0 - values[k] ** 2
        xbar = np.empty_like(x)
        self._back.run([x, p, bar], [xbar])
        return xbar

    def _values(self, theta: Array, x: Array, p: Array) -> list[Array]:
        """The observation, the hidden layers, and the mean action."""
        seen = np.empty((self._layers.sizes[0], x.shape[-1]))
        self._observe.run([x, p], [seen])
        values = [seen]
        for middle, end, before, after in self._places():
            if len(values) > 1:
                np.tanh(values[-1], out=values[-1])
            weights = theta[middle - before * after : middle].reshape(after, before, -1)
            values.append(_summed(weights, values[-1], (1, 2)) + theta[middle:end])
        return values

    def _places(self) -> list[tuple[int, int, int, int]]:
        """Of every layer: where its offsets begin and end in theta, and its sizes."""
        found, at = [], 0
        for before, after in pairwise(self._layers.sizes):
            found.append((at + before * after, at + (before + 1) * after, before, after))
            at = found[-1][1]
        return found


def _summed(weights: Array, values: Array, axes: tuple[int, int]) -> Array:
    """`sum_i w_oi v_i`, or with axes (0, 2) `sum_o w_oi v_o`, for each sample m."""
    contracted = axes[0]
    if weights.shape[-1] == 1:
        matrix = weights[..., 0] if contracted == 1 else weights[..., 0].T
        return matrix @ values
    return np.einsum("oim,im->om" if contracted == 1 else "oim,om->im", weights, values)
