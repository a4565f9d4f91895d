"""The part of training that is JAX's: a network, Adam's state, and one compiled epoch."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from dynamics.learned.training import Recipe

DRAWS, HELD = 1, 2
"""Streams of random numbers: of epochs, of the noise of held-out rows."""


@dataclass(frozen=True)
class Progress:
    """Where training is: layers and Adam's moments now, and the layers of the least error.

    Replaced as a whole after every epoch, so that what interrupts one leaves that before it.
    """

    layers: Any
    moments: Any
    best: Any
    number: int = 0
    best_at: int = 0
    least: float = math.inf


class Network:
    """What training does to the weights of a network, float32, on JAX's device."""

    def __init__(self, n_in: int, n_out: int, recipe: Recipe, sigma: float, seed: int) -> None:
        jax, _, optax = _libraries()
        self._jax, key = jax, jax.random.key(seed, impl="threefry2x32")
        self._sigma = np.float32(sigma)
        self._draws, self._held = (jax.random.fold_in(key, stream) for stream in (DRAWS, HELD))
        layers = _layers((n_in, *recipe.hidden, n_out), key)
        self.start = Progress(layers, optax.adam(recipe.rate).init(layers), layers)
        self._epoch, self._errors = _compiled(recipe.batch, recipe.rate, sigma > 0)

    def on_device(self, z: np.ndarray, y: np.ndarray) -> tuple[Any, Any]:
        """Rows where the epochs read them."""
        return self._jax.device_put(z), self._jax.device_put(y)

    def epoch(self, now: Progress, z: Any, y: Any) -> tuple[Progress, float]:
        """One more pass, in a fresh order with fresh noise, and its mean loss."""
        number = now.number + 1
        key = self._jax.random.fold_in(self._draws, number)
        layers, moments, loss = self._epoch(now.layers, now.moments, key, self._sigma, z, y)
        return replace(now, layers=layers, moments=moments, number=number), float(loss)

    def errors(self, layers: Any, z: Any, y: Any) -> tuple[float, float]:
        """Mean squared error on clean and on noised inputs, the same noise after every epoch."""
        clean, noised = self._errors(layers, self._held, self._sigma, z, y)
        return float(clean), float(noised)

    def arrays(self, now: Progress) -> dict[str, np.ndarray]:
        """Progress as arrays alone."""
        leaves = self._jax.tree.leaves((now.layers, now.moments, now.best))
        found = {f"leaf_{i}": np.asarray(leaf) for i, leaf in enumerate(leaves)}
        return {"progress": np.array([now.number, now.best_at, now.least]), **found}

    def progress(self, arrays: dict[str, np.ndarray]) -> Progress:
        """Back from :meth:`arrays`."""
        jax, start = self._jax, self.start
        leaves, structure = jax.tree.flatten((start.layers, start.moments, start.best))
        found = [jax.numpy.asarray(arrays[f"leaf_{i}"]) for i in range(len(leaves))]
        number, best_at, least = arrays["progress"]
        layers, moments, best = jax.tree.unflatten(structure, found)
        return Progress(layers, moments, best, int(number), int(best_at), float(least))


def arrays_of(layers: Any) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """Weights and biases, layer by layer, float64."""
    weights = tuple(np.array(layer.weight, float) for layer in layers)
    return weights, tuple(np.array(layer.bias, float) for layer in layers)


@functools.cache
def _compiled(batch: int, rate: float, noised: bool) -> tuple[Any, Any]:
    """An epoch and the errors of some rows, compiled once for all networks of equal sizes."""
    jax, _, optax = _libraries()
    adam = optax.adam(rate)

    def noise(key: Any, z: Any, sigma: Any) -> Any:
        return z + sigma * jax.random.normal(key, z.shape, z.dtype) if noised else z

    def loss(layers: Any, z: Any, y: Any) -> Any:
        return jax.numpy.mean((jax.vmap(lambda row: evaluate(layers, row))(z) - y) ** 2)

    @jax.jit
    def epoch(layers: Any, moments: Any, key: Any, sigma: Any, z: Any, y: Any) -> Any:
        size = min(batch, len(z))
        steps = len(z) // size
        order, draws = jax.random.split(key)
        # What does not fill a batch waits for another epoch, which has another order.
        rows = jax.random.permutation(order, len(z))[: steps * size].reshape(steps, size)

        def step(carried: Any, drawn: Any) -> Any:
            (layers, moments), (rows, key) = carried, drawn
            value, slopes = jax.value_and_grad(loss)(layers, noise(key, z[rows], sigma), y[rows])
            updates, moments = adam.update(slopes, moments)
            return (optax.apply_updates(layers, updates), moments), value

        keys = jax.random.split(draws, steps)
        carried, values = jax.lax.scan(step, (layers, moments), (rows, keys))
        return *carried, jax.numpy.mean(values)

    @jax.jit
    def errors(layers: Any, key: Any, sigma: Any, z: Any, y: Any) -> Any:
        return loss(layers, z, y), loss(layers, noise(key, z, sigma), y)

    return epoch, errors


def evaluate(layers: Any, z: Any) -> Any:
    """The network of Equinox's layers at one row, normalised in and out."""
    import jax

    for layer in layers[:-1]:
        z = jax.nn.elu(layer(z))
    return layers[-1](z)


def _layers(sizes: tuple[int, ...], key: Any) -> tuple[Any, ...]:
    jax, eqx, _ = _libraries()
    keys = jax.random.split(key, len(sizes) - 1)
    return tuple(
        eqx.nn.Linear(n_in, n_out, dtype=jax.numpy.float32, key=key)
        for (n_in, n_out), key in zip(pairwise(sizes), keys, strict=True)
    )


def _libraries() -> tuple[Any, Any, Any]:
    """JAX, Equinox, Optax.

    Raises ``ValueError`` that names the extra which installs them.
    """
    try:
        import equinox
        import jax
        import optax
    except ImportError as error:
        raise ValueError(
            "training a network needs JAX, Equinox and Optax, which the extra learn installs: pip"
            " install 'centralpath[learn]' (evaluating one needs none of them)"
        ) from error
    return jax, equinox, optax
