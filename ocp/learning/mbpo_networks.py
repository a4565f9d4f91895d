"""Networks of model-based policy optimisation: an ensemble of models, and a soft actor-critic.

Janner et al., When to trust your model, 2019; Haarnoja et al., Soft actor-critic algorithms and
applications, 2018. Actions are those before tanh, as the engine's policies have them; densities and
critics are of their tanh, in [-1, 1].
"""

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
    rng: np.random.Generator,
    members: int,
    n_in: int,
    hidden: tuple[int, ...],
    n_out: int,
    rate: float,
) -> Learner:
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


NARROWEST, WIDEST = -8.0, 2.0
"""Bounds of the logarithm of an action's standard deviation."""


class Actor(NamedTuple):
    """tanh layers ``trunk``, and on them a layer for means and one for log-deviations."""

    trunk: Layers
    mean: tuple[Any, Any]
    spread: tuple[Any, Any]


class Networks(NamedTuple):
    """What is learned: actor, two critics (stacked), logarithm of the temperature."""

    actor: Actor
    critics: Layers
    log_alpha: Any


class Agent(NamedTuple):
    """Networks, the slow copy of the critics, and the moments of three Adams."""

    networks: Networks
    targets: Layers
    moments: tuple[Any, Any, Any]


class Batch(NamedTuple):
    """Normalised observations, tanh actions, rewards, ends (1 or 0), next observations."""

    o: Any
    t: Any
    reward: Any
    ended: Any
    o_next: Any


class Rates(NamedTuple):
    """Learning ``rate``, ``discount``, ``slow``, the targets' rate, ``aim``, entropy an input."""

    rate: float
    discount: float
    slow: float
    aim: float


def begin_agent(
    rng: np.random.Generator,
    n_o: int,
    hidden: tuple[int, ...],
    nu: int,
    critics: tuple[int, ...],
    initial: float,
    sigma: float,
    alpha: float,
    rate: float,
) -> Agent:
    """Networks at their start: means ``initial`` times as large, all deviations ``sigma``."""
    *trunk, mean = begin(rng, (n_o, *hidden, nu), initial)
    networks = Networks(
        Actor(tuple(trunk), mean, (np.zeros_like(mean[0]), np.full(nu, np.log(sigma), np.float32))),
        begin_many(rng, 2, (n_o + nu, *critics, 1)),
        np.log(np.float32(alpha)),
    )
    adam = optax.adam(rate)
    moments = jax.jit(lambda *parts: tuple(adam.init(part) for part in parts))(*networks)
    return Agent(networks, networks.critics, moments)


def actions(actor: Actor, o: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Means and log-deviations (n, nu) of actions before tanh."""
    for W, b in actor.trunk:
        o = jnp.tanh(o @ W.T + b)
    mean, spread = (o @ W.T + b for W, b in (actor.mean, actor.spread))
    return mean, jnp.clip(spread, NARROWEST, WIDEST)


def drawn(actor: Actor, o: jax.Array, noise: jax.Array) -> tuple[jax.Array, jax.Array]:
    """``tanh(a)``, ``a = mean + exp(s) noise``, and the log-density of tanh(a), (n,).

    ``sum_j -noise_j²/2 - s_j - log(2 pi)/2 - log(1 - tanh(a_j)²)``.
    """
    mean, spread = actions(actor, o)
    a = mean + jnp.exp(spread) * noise
    squash = 2 * (jnp.log(2.0) - a - jax.nn.softplus(-2 * a))
    each = -0.5 * noise**2 - spread - 0.5 * jnp.log(2 * jnp.pi) - squash
    return jnp.tanh(a), each.sum(axis=1)


def judged(critics: Layers, o: jax.Array, t: jax.Array) -> jax.Array:
    """Both critics' values (2, n)."""
    z = jnp.concatenate([o, t], axis=1)
    return jax.vmap(lambda layers: values(layers, z, jax.nn.relu)[:, 0])(critics)


def targets_of(agent: Agent, batch: Batch, noise: jax.Array, discount: float | jax.Array) -> jax.Array:
    """``r + discount (1 - ended) (min_j Q'_j(o', t') - alpha log pi(t' | o'))``, (n,)."""
    t, log_density = drawn(agent.networks.actor, batch.o_next, noise)
    soft = judged(agent.targets, batch.o_next, t).min(axis=0)
    soft -= jnp.exp(agent.networks.log_alpha) * log_density
    return batch.reward + discount * (1 - batch.ended) * soft


def critic_loss(critics: Layers, batch: Batch, target: jax.Array) -> jax.Array:
    """``sum_j mean (Q_j - target)² / 2``."""
    return 0.5 * jnp.mean((judged(critics, batch.o, batch.t) - target) ** 2, axis=1).sum()


def actor_loss(
    actor: Actor, critics: Layers, log_alpha: jax.Array, o: jax.Array, noise: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """``mean (alpha log pi - min_j Q_j)`` of fresh actions, and the mean of log pi."""
    t, log_density = drawn(actor, o, noise)
    best = judged(critics, o, t).min(axis=0)
    return jnp.mean(jnp.exp(log_alpha) * log_density - best), log_density.mean()


def temperature_loss(log_alpha: jax.Array, log_density: jax.Array, aim: float) -> jax.Array:
    """``-log alpha (mean log pi + aim)``: alpha grows while the entropy is below ``aim``."""
    return -log_alpha * jax.lax.stop_gradient(log_density + aim)


@functools.cache
def updater(rates: Rates) -> Callable[..., tuple[Agent, dict[str, jax.Array]]]:
    """``(agent, data, rows (updates, batch), key)`` to the agent and what is told of updates."""
    adam = optax.adam(rates.rate)

    def moved(slopes: Any, moments: Any, part: Any) -> tuple[Any, Any]:
        updates, moments = adam.update(slopes, moments, part)
        return optax.apply_updates(part, updates), moments

    def update(agent: Agent, given: Any) -> tuple[Agent, Any]:
        (actor, critics, log_alpha), (first, second, third) = agent.networks, agent.moments
        batch, key = given
        shape = batch.t.shape
        noises = (jax.random.normal(each, shape) for each in jax.random.split(key))
        target = targets_of(agent, batch, next(noises), rates.discount)
        loss, slopes = jax.value_and_grad(critic_loss)(critics, batch, target)
        critics, second = moved(slopes, second, critics)
        of_actor = jax.value_and_grad(actor_loss, has_aux=True)
        (_, density), slopes = of_actor(actor, critics, log_alpha, batch.o, next(noises))
        actor, first = moved(slopes, first, actor)
        slope = jax.grad(temperature_loss)(log_alpha, density, rates.aim * shape[1])
        log_alpha, third = moved(slope, third, log_alpha)
        slow = jax.tree.map(lambda old, new: old + rates.slow * (new - old), agent.targets, critics)
        networks = Networks(actor, critics, log_alpha)
        told = {
            "critic_loss": loss,
            "entropy": -density,
            "gradient_norm": sum(jnp.sum(leaf**2) for leaf in jax.tree.leaves(slopes)) ** 0.5,
        }
        return Agent(networks, slow, (first, second, third)), told

    @jax.jit
    def updates(agent: Agent, data: Batch, rows: Any, key: Any) -> tuple[Agent, Any]:
        def step(agent: Agent, given: Any) -> tuple[Agent, Any]:
            some, key = given
            return update(agent, (Batch(*(column[some] for column in data)), key))

        return jax.lax.scan(step, agent, (rows, jax.random.split(key, len(rows))))

    return updates


act = jax.jit(drawn)
"""tanh actions (n, nu) and their log-densities, compiled."""


def theta_of(actor: Actor) -> np.ndarray:
    """The mean action as the engine's dense policy holds it: W row by row, b, layer by layer."""
    parts = [part for layer in (*actor.trunk, actor.mean) for part in layer]
    return np.concatenate([np.asarray(part, dtype=float).ravel() for part in parts])
