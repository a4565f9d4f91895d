"""The weighted average as a user would write it in NumPy, JAX and KeOps, each in its fastest form."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

jax.config.update("jax_enable_x64", True)
HAS_KEOPS = importlib.util.find_spec("pykeops") is not None


@dataclass(frozen=True)
class Average:
    """Data in normalised units, and peers that prepare all they can before the first query."""

    z: np.ndarray
    y: np.ndarray
    sigma: float

    @property
    def square(self) -> np.ndarray:
        """Squared norms ``|z_i|²`` (n,)."""
        return np.sum(self.z**2, axis=1)

    def blas(self, block: int) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
        """Return value and Jacobian at one query, by matrix products over all the points.

        Moments are of ``block`` points at a time, so that their weighted targets stay in the cache.
        """
        z, square, slope = self.z, self.square, -0.5 / self.sigma**2
        left = np.column_stack((np.ones(len(z)), self.y)).T
        right = np.column_stack((np.ones(len(z)), z))
        cuts = [slice(begin, begin + block) for begin in range(0, len(z), block)]
        parts = [(cut, np.ascontiguousarray(left[:, cut]), right[cut]) for cut in cuts]
        w, weighted = np.empty(len(z)), np.empty((len(left), min(block, len(z))))

        def at(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            np.dot(z, -2 * q, out=w)
            np.add(w, square, out=w)
            np.subtract(w, w.min(), out=w)
            np.multiply(w, slope, out=w)
            sums = np.zeros((len(left), right.shape[1]))
            for cut, a, b in parts:
                np.exp(w[cut], out=w[cut])
                sums += np.multiply(a, w[cut], out=weighted[:, : len(b)]) @ b
            return self._moments(sums)

        return at

    def blas_near(self) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
        """Return the same with moments over points of significant weight alone."""
        z, square, slope = self.z, self.square, -0.5 / self.sigma**2
        left = np.column_stack((np.ones(len(z)), self.y))
        right = np.column_stack((np.ones(len(z)), z))
        d = np.empty(len(z))

        def at(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            np.dot(z, -2 * q, out=d)
            np.add(d, square, out=d)
            least = d.min()
            near = np.flatnonzero(d < least - np.log(1e-25) * 2 * self.sigma**2)
            w = np.exp(slope * (d[near] - least))
            return self._moments((left[near] * w[:, None]).T @ right[near])

        return at

    def _moments(self, sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        mean = sums / sums[0, 0]
        slopes = mean[1:, 1:] - np.outer(mean[1:, 0], mean[0, 1:])
        return mean[1:, 0], slopes / self.sigma**2

    def jax_along(self, queries: np.ndarray) -> Callable[[], tuple[np.ndarray, np.ndarray]]:
        """Return values and Jacobians at all queries, in one compiled loop."""
        z, square, slope = jnp.asarray(self.z), jnp.asarray(self.square), -0.5 / self.sigma**2
        left = jnp.column_stack((jnp.ones(len(z)), self.y)).T
        right = jnp.column_stack((jnp.ones(len(z)), z))

        def at(q):
            d = square - 2 * (z @ q)
            mean = (left * jnp.exp(slope * (d - d.min()))) @ right
            mean = mean / mean[0, 0]
            slopes = mean[1:, 1:] - jnp.outer(mean[1:, 0], mean[0, 1:])
            return mean[1:, 0], slopes / self.sigma**2

        path = jnp.asarray(queries)
        along = jax.jit(lambda q: lax.map(at, q))
        return lambda: jax.block_until_ready(along(path))

    def blas_blocks(self, queries: np.ndarray, block: int) -> Callable[[], np.ndarray]:
        """Return values at all queries, ``block`` at a time."""
        double, half = -2 * np.ascontiguousarray(self.z.T), -0.5 / self.sigma**2
        square, left = self.square, np.column_stack((np.ones(len(self.z)), self.y))
        d = np.empty((block, len(self.z)))

        def values() -> np.ndarray:
            found = []
            for begin in range(0, len(queries), block):
                np.dot(queries[begin : begin + block], double, out=d)
                np.add(d, square, out=d)
                np.subtract(d, d.min(axis=1, keepdims=True), out=d)
                np.multiply(d, half, out=d)
                np.exp(d, out=d)
                sums = d @ left
                found.append(sums[:, 1:] / sums[:, :1])
            return np.concatenate(found)

        return values

    def jax_blocks(self, queries: np.ndarray, block: int) -> Callable[[], np.ndarray]:
        """Return values at all queries, ``block`` at a time in one compiled loop."""
        z, square, slope = jnp.asarray(self.z.T), jnp.asarray(self.square), -0.5 / self.sigma**2
        left = jnp.column_stack((jnp.ones(len(self.z)), self.y))

        def at(q):
            d = square - 2 * (q @ z)
            sums = jnp.exp(slope * (d - d.min(axis=1, keepdims=True))) @ left
            return sums[:, 1:] / sums[:, :1]

        parts = jnp.asarray(queries).reshape(-1, block, queries.shape[1])
        every = jax.jit(lambda q: lax.map(at, q))
        return lambda: jax.block_until_ready(every(parts)).reshape(len(queries), -1)

    def keops(self, queries: np.ndarray) -> Callable[[], np.ndarray]:
        """Return values at all queries, from a lazy product that is never stored."""
        from pykeops.numpy import LazyTensor

        q, z = LazyTensor(queries[:, None, :]), LazyTensor(self.z[None, :, :])
        y = LazyTensor(self.y[None, :, :])
        exponent = -((q - z) ** 2).sum(-1) / (2 * self.sigma**2)
        return lambda: exponent.sumsoftmaxweight(y, axis=1)
