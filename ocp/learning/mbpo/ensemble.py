"""An ensemble of networks that say the next state with its uncertainty."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

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


PULL = 0.01
"""Weight of what draws the bounds of the log-variance together."""
DECAY = 1e-5
"""Weight decay (mbrl-lib's configuration of MBPO)."""
FIRST_BOUNDS = -10.0, 0.5
"""Of the log-variance of normalised outputs (Chua et al., 2018)."""


class Ensemble(NamedTuple):
    """Networks of ``members``, stacked, and bounds ``least``, ``most`` (ny,) of log-variances."""

    layers: Layers
    least: Any
    most: Any


class Learner(NamedTuple):
    """An ensemble and the moments of Adam."""

    ensemble: Ensemble
    moments: Any


def begin_learner(
    rng: np.random.Generator, members: int, n_in: int, hidden: tuple[int, ...], n_out: int,
    rate: float,
) -> Learner:  # fmt: skip
    """Networks that start apart."""
    layers = begin_many(rng, members, (n_in, *hidden, 2 * n_out))
    least, most = (np.full(n_out, bound, np.float32) for bound in FIRST_BOUNDS)
    ensemble = Ensemble(layers, least, most)
    return Learner(ensemble, jax.jit(optax.adamw(rate, weight_decay=DECAY).init)(ensemble))


def gaussians(ensemble: Ensemble, z: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Means and log-variances (members, n, ny) at ``z`` (members, n, nz).

    With s the networks' second half of outputs and bounds m < M: ``l = M - softplus(M - s)`` and
    ``log var = m + softplus(l - m)``, which lies between them and has a slope everywhere.
    """
    out = jax.vmap(lambda layers, rows: values(layers, rows, jax.nn.silu))(ensemble.layers, z)
    mean, raw = jnp.split(out, 2, axis=-1)
    below = ensemble.most - jax.nn.softplus(ensemble.most - raw)
    return mean, ensemble.least + jax.nn.softplus(below - ensemble.least)


def likelihood_loss(ensemble: Ensemble, z: jax.Array, y: jax.Array) -> jax.Array:
    """``sum_members mean ((mean - y)² / var + log var) + 0.01 sum (M - m)`` (Chua et al., 2018).

    Twice the negative log-likelihood of y (members, n, ny) but for a constant.
    """
    mean, log_var = gaussians(ensemble, z)
    off = (mean - y) ** 2 * jnp.exp(-log_var) + log_var
    return off.mean(axis=(1, 2)).sum() + PULL * (ensemble.most - ensemble.least).sum()


@functools.cache
def trainer(rate: float) -> Callable[..., tuple[Learner, jax.Array]]:
    """``(learner, z (n, nz), y (n, ny), rows (steps, members, batch))`` to learner and losses."""
    adam = optax.adamw(rate, weight_decay=DECAY)

    @jax.jit
    def train(learner: Learner, z: Any, y: Any, rows: Any) -> tuple[Learner, jax.Array]:
        def step(learner: Learner, drawn: Any) -> tuple[Learner, jax.Array]:
            slope = jax.value_and_grad(likelihood_loss)
            loss, slopes = slope(learner.ensemble, z[drawn], y[drawn])
            updates, moments = adam.update(slopes, learner.moments, learner.ensemble)
            changed: Any = optax.apply_updates(learner.ensemble, updates)
            return Learner(changed, moments), loss

        return jax.lax.scan(step, learner, rows)

    return train


@jax.jit
def member_errors(ensemble: Ensemble, z: Any, y: Any, known: Any) -> jax.Array:
    """Mean squared errors (members,) of the means over rows (n,) that are ``known``."""
    members = ensemble.layers[0][0].shape[0]
    mean, _ = gaussians(ensemble, jnp.broadcast_to(z, (members, *z.shape)))
    off = jnp.mean((mean - y) ** 2, axis=2)
    return jnp.sum(jnp.where(known, off, 0.0), axis=1) / jnp.maximum(jnp.sum(known), 1)


def elites_of(errors: np.ndarray, n: int) -> np.ndarray:
    """The ``n`` members with the least held-out errors, best first; of equals the first."""
    return np.argsort(errors, kind="stable")[:n]


@jax.jit
def drawn_next(ensemble: Ensemble, member: Any, z: Any, noise: Any) -> jax.Array:
    """``mean + noise sqrt(var)`` (n, ny) of each row's ``member`` (n,), noise (n, ny) standard."""
    members = ensemble.layers[0][0].shape[0]
    mean, log_var = gaussians(ensemble, jnp.broadcast_to(z, (members, *z.shape)))
    row = jnp.arange(z.shape[0])
    return mean[member, row] + jnp.exp(0.5 * log_var[member, row]) * noise
