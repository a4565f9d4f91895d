"""Dense layers, many networks of one shape at once, and trees of them as named arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import jax
import numpy as np

Layers = tuple[tuple[Any, Any], ...]
"""``W`` (n_out, n_in) and ``b`` (n_out,) of each layer."""


def begin(rng: np.random.Generator, sizes: Sequence[int], last: float = 1.0) -> Layers:
    """Normal weights of deviation 1 / sqrt(n_in), the last layer's ``last`` times that; b = 0."""
    found = []
    for i, (n_in, n_out) in enumerate(pairwise(sizes)):
        size = (last if i == len(sizes) - 2 else 1.0) / n_in**0.5
        W = size * rng.standard_normal((n_out, n_in))
        found.append((W.astype(np.float32), np.zeros(n_out, np.float32)))
    return tuple(found)


def begin_many(rng: np.random.Generator, n: int, sizes: Sequence[int]) -> Layers:
    """``n`` networks that start apart, stacked along the first axis."""
    return jax.tree.map(lambda *leaves: np.stack(leaves), *(begin(rng, sizes) for _ in range(n)))


def values(layers: Layers, z: jax.Array, act: Callable[[jax.Array], jax.Array]) -> jax.Array:
    """Outputs (n, n_out) at ``z`` (n, n_in), ``act`` between the layers."""
    for W, b in layers[:-1]:
        z = act(z @ W.T + b)
    W, b = layers[-1]
    return z @ W.T + b


def arrays(prefix: str, tree: Any) -> dict[str, np.ndarray]:
    """Leaves of ``tree`` as ``prefix.0``, ``prefix.1`` and so on."""
    return {f"{prefix}.{i}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(tree))}


def tree_of(prefix: str, state: dict[str, np.ndarray], like: Any) -> Any:
    """Back from :func:`arrays`, in the structure of ``like``."""
    leaves, structure = jax.tree.flatten(like)
    found = [state[f"{prefix}.{i}"] for i in range(len(leaves))]
    return jax.tree.unflatten(structure, found)
