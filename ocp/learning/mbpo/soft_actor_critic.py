"""Soft actor-critic: twin critics, slow targets, a temperature that keeps the entropy.

Haarnoja et al., Soft actor-critic algorithms and applications, 2018. Actions are those before
tanh, as the engine's policies have them; densities and critics are of their tanh, in [-1, 1].
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from ocp.learning.mbpo.ensemble import Layers, begin, begin_many, values

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
    rng: np.random.Generator, n_o: int, hidden: tuple[int, ...], nu: int, critics: tuple[int, ...],
    initial: float, sigma: float, alpha: float, rate: float,
) -> Agent:  # fmt: skip
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


def targets_of(
    agent: Agent, batch: Batch, noise: jax.Array, discount: float | jax.Array
) -> jax.Array:
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
