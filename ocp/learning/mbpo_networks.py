"""Networks of model-based policy optimisation: an ensemble of models, and a soft actor-critic.

Sources: Janner et al., When to trust your model, 2019; Haarnoja et al., Soft actor-critic algorithms
and applications, 2018. As in the batch engine's policies, an action is the value before tanh; densities
and critics are functions of its tanh, in [-1, 1].
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from dynamics.batch.graphs.step_graphs import layer_slices
from ocp.learning.protocol import Layers, first_weights


def initial_layers(rng: np.random.Generator, sizes: Sequence[int], last: float = 1.0) -> Layers:
    """Return the random layers that :func:`~ocp.learning.protocol.first_weights` draws, in single precision."""
    theta = first_weights(sizes, last, rng).astype(np.float32)
    return tuple((theta[weights].reshape(shape), theta[b]) for weights, b, shape in layer_slices(sizes))


def initial_ensemble(rng: np.random.Generator, n: int, sizes: Sequence[int]) -> Layers:
    """Return ``n`` networks with different random weights, stacked along the first axis."""
    return jax.tree.map(lambda *leaves: np.stack(leaves), *(initial_layers(rng, sizes) for _ in range(n)))


def forward(layers: Layers, z: jax.Array, activation: Callable[[jax.Array], jax.Array]) -> jax.Array:
    """Return a network's outputs (n, n_out) at ``z`` (n, n_in), with ``activation`` between its layers."""
    for W, b in layers[:-1]:
        z = activation(z @ W.T + b)
    W, b = layers[-1]
    return z @ W.T + b


def tree_arrays(prefix: str, tree: Any) -> dict[str, np.ndarray]:
    """Return a mapping from ``prefix.0``, ``prefix.1`` and so on to the leaves of ``tree``."""
    return {f"{prefix}.{i}": np.asarray(leaf) for i, leaf in enumerate(jax.tree.leaves(tree))}


def tree_from_arrays(prefix: str, state: dict[str, np.ndarray], like: Any) -> Any:
    """Rebuild a tree with the structure of ``like`` from the arrays of :func:`tree_arrays` in ``state``."""
    leaves, structure = jax.tree.flatten(like)
    leaf_arrays = [state[f"{prefix}.{i}"] for i in range(len(leaves))]
    return jax.tree.unflatten(structure, leaf_arrays)


BOUND_SPREAD_WEIGHT = 0.01
"""Weight, in the loss, of the distance between the two bounds of the log-variance."""
WEIGHT_DECAY = 1e-5
"""Weight decay of the model's optimiser, as in mbrl-lib's configuration of MBPO."""
INITIAL_LOG_VARIANCE_BOUNDS = -10.0, 0.5
"""Initial lower and upper bound of the log-variance of normalised outputs (Chua et al., 2018)."""


class Ensemble(NamedTuple):
    """Ensemble of probabilistic networks, stacked along the first axis, and bounds (ny,) of predicted log-variances."""

    layers: Layers
    min_log_variance: Any
    max_log_variance: Any


class Learner(NamedTuple):
    """An ensemble together with the state of its optimiser."""

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
    """Return an ensemble with random weights and its optimiser's initial state."""
    layers = initial_ensemble(rng, members, (n_in, *hidden, 2 * n_out))
    ensemble = Ensemble(layers, *(np.full(n_out, bound, np.float32) for bound in INITIAL_LOG_VARIANCE_BOUNDS))
    return Learner(ensemble, jax.jit(optax.adamw(rate, weight_decay=WEIGHT_DECAY).init)(ensemble))


def predict_gaussians(ensemble: Ensemble, z: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return means and log-variances (members, n, ny) at ``z`` (members, n, nz).

    The second half s of the networks' outputs gives ``l = M - softplus(M - s)`` and ``log var = m + softplus(l
    - m)``, where m < M are the bounds. This is a smooth function of s with values between the bounds.
    """
    outputs = jax.vmap(lambda layers, rows: forward(layers, rows, jax.nn.silu))(ensemble.layers, z)
    mean, raw = jnp.split(outputs, 2, axis=-1)
    upper_bounded = ensemble.max_log_variance - jax.nn.softplus(ensemble.max_log_variance - raw)
    return mean, ensemble.min_log_variance + jax.nn.softplus(upper_bounded - ensemble.min_log_variance)


def likelihood_loss(ensemble: Ensemble, z: jax.Array, y: jax.Array) -> jax.Array:
    """Return ``sum_members mean ((mean - y)² / var + log var) + 0.01 sum (M - m)`` (Chua et al., 2018).

    The first sum is twice the negative log-likelihood of y (members, n, ny) up to a constant.
    """
    mean, log_var = predict_gaussians(ensemble, z)
    errors = (mean - y) ** 2 * jnp.exp(-log_var) + log_var
    return (
        errors.mean(axis=(1, 2)).sum()
        + BOUND_SPREAD_WEIGHT * (ensemble.max_log_variance - ensemble.min_log_variance).sum()
    )


@functools.cache
def make_trainer(rate: float) -> Callable[..., tuple[Learner, jax.Array]]:
    """Return a function ``(learner, z (n, nz), y (n, ny), rows (steps, members, batch)) -> (learner, losses)``."""
    adam = optax.adamw(rate, weight_decay=WEIGHT_DECAY)

    @jax.jit
    def train(learner: Learner, z: Any, y: Any, rows: Any) -> tuple[Learner, jax.Array]:
        def step(learner: Learner, batch_rows: Any) -> tuple[Learner, jax.Array]:
            slope = jax.value_and_grad(likelihood_loss)
            loss, slopes = slope(learner.ensemble, z[batch_rows], y[batch_rows])
            updates, moments = adam.update(slopes, learner.moments, learner.ensemble)
            changed: Any = optax.apply_updates(learner.ensemble, updates)
            return Learner(changed, moments), loss

        return jax.lax.scan(step, learner, rows)

    return train


@jax.jit
def member_errors(ensemble: Ensemble, z: Any, y: Any, is_known: Any) -> jax.Array:
    """Return each member's mean squared error (members,) of predicted means over the rows in the mask ``is_known``."""
    members = ensemble.layers[0][0].shape[0]
    mean, _ = predict_gaussians(ensemble, jnp.broadcast_to(z, (members, *z.shape)))
    squared_errors = jnp.mean((mean - y) ** 2, axis=2)
    return jnp.sum(jnp.where(is_known, squared_errors, 0.0), axis=1) / jnp.maximum(jnp.sum(is_known), 1)


def select_elites(errors: np.ndarray, n: int) -> np.ndarray:
    """Return the indices of the ``n`` members with the smallest ``errors``, best first."""
    return np.argsort(errors, kind="stable")[:n]


@jax.jit
def sample_next_states(ensemble: Ensemble, member: Any, z: Any, noise: Any) -> jax.Array:
    """Return samples ``mean + noise sqrt(var)`` (n, ny) with noise (n, ny), row i from member ``member[i]``."""
    members = ensemble.layers[0][0].shape[0]
    mean, log_var = predict_gaussians(ensemble, jnp.broadcast_to(z, (members, *z.shape)))
    row = jnp.arange(z.shape[0])
    return mean[member, row] + jnp.exp(0.5 * log_var[member, row]) * noise


MIN_LOG_DEVIATION = -8.0
"""Lower bound of the logarithm of an action's standard deviation."""
MAX_LOG_DEVIATION = 2.0
"""Upper bound of the logarithm of an action's standard deviation."""


class Actor(NamedTuple):
    """Actor network: tanh layers ``trunk``, then a layer for the means and a layer for the log standard deviations."""

    trunk: Layers
    mean: tuple[Any, Any]
    spread: tuple[Any, Any]


class Networks(NamedTuple):
    """Trained parameters of an agent: actor, two critics (stacked), and the logarithm of the temperature."""

    actor: Actor
    critics: Layers
    log_alpha: Any


class Agent(NamedTuple):
    """Soft actor-critic agent: networks, target critics, and the states of the three optimisers."""

    networks: Networks
    targets: Layers
    moments: tuple[Any, Any, Any]


class Batch(NamedTuple):
    """Batch of transitions: normalised observations, tanh actions, rewards, ended (1 or 0), next observations."""

    o: Any
    t: Any
    reward: Any
    ended: Any
    o_next: Any


class Rates(NamedTuple):
    """Settings of updates: learning rate, discount, rate ``tau`` of target critics, and target entropy per input."""

    rate: float
    discount: float
    tau: float
    target_entropy: float


def begin_agent(
    rng: np.random.Generator,
    actor_sizes: tuple[int, ...],
    critics: tuple[int, ...],
    initial: float,
    sigma: float,
    alpha: float,
    rate: float,
) -> Agent:
    """Return an agent with random networks: last weights of the means scaled by ``initial``, deviations ``sigma``.

    ``actor_sizes`` are the sizes of the actor's layers from observation to input, and ``critics`` the sizes of
    the critics' hidden layers.
    """
    n_o, *_, nu = actor_sizes
    *trunk, mean = initial_layers(rng, actor_sizes, initial)
    networks = Networks(
        Actor(tuple(trunk), mean, (np.zeros_like(mean[0]), np.full(nu, np.log(sigma), np.float32))),
        initial_ensemble(rng, 2, (n_o + nu, *critics, 1)),
        np.log(np.float32(alpha)),
    )
    adam = optax.adam(rate)
    moments = jax.jit(lambda *parts: tuple(adam.init(part) for part in parts))(*networks)
    return Agent(networks, networks.critics, moments)


def action_moments(actor: Actor, o: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the means and log standard deviations (n, nu) of actions before tanh."""
    for W, b in actor.trunk:
        o = jnp.tanh(o @ W.T + b)
    mean, spread = (o @ W.T + b for W, b in (actor.mean, actor.spread))
    return mean, jnp.clip(spread, MIN_LOG_DEVIATION, MAX_LOG_DEVIATION)


def sample_actions(actor: Actor, o: jax.Array, noise: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return sampled actions ``tanh(a)`` (n, nu) with ``a = mean + exp(s) noise``, and their log-densities (n,).

    The log-density is ``sum_j -noise_j²/2 - s_j - log(2 pi)/2 - log(1 - tanh(a_j)²)``.
    """
    mean, spread = action_moments(actor, o)
    a = mean + jnp.exp(spread) * noise
    squash = 2 * (jnp.log(2.0) - a - jax.nn.softplus(-2 * a))
    log_densities = -0.5 * noise**2 - spread - 0.5 * jnp.log(2 * jnp.pi) - squash
    return jnp.tanh(a), log_densities.sum(axis=1)


def critic_values(critics: Layers, o: jax.Array, t: jax.Array) -> jax.Array:
    """Return the values (2, n) of both critics at observations ``o`` (n, n_o) and tanh actions ``t`` (n, nu)."""
    z = jnp.concatenate([o, t], axis=1)
    return jax.vmap(lambda layers: forward(layers, z, jax.nn.relu)[:, 0])(critics)


def critic_targets(agent: Agent, batch: Batch, noise: jax.Array, discount: float | jax.Array) -> jax.Array:
    """Return the critics' targets ``r + discount (1 - ended) (min_j Q'_j(o', t') - alpha log pi(t' | o'))``, (n,)."""
    t, log_density = sample_actions(agent.networks.actor, batch.o_next, noise)
    soft = critic_values(agent.targets, batch.o_next, t).min(axis=0)
    soft -= jnp.exp(agent.networks.log_alpha) * log_density
    return batch.reward + discount * (1 - batch.ended) * soft


def critic_loss(critics: Layers, batch: Batch, target: jax.Array) -> jax.Array:
    """Return the critics' loss ``sum_j mean (Q_j - target)² / 2``."""
    return 0.5 * jnp.mean((critic_values(critics, batch.o, batch.t) - target) ** 2, axis=1).sum()


def actor_loss(
    actor: Actor, critics: Layers, log_alpha: jax.Array, o: jax.Array, noise: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return the actor's loss ``mean (alpha log pi - min_j Q_j)`` on sampled actions, and the mean of log pi."""
    t, log_density = sample_actions(actor, o, noise)
    least_value = critic_values(critics, o, t).min(axis=0)
    return jnp.mean(jnp.exp(log_alpha) * log_density - least_value), log_density.mean()


def temperature_loss(log_alpha: jax.Array, log_density: jax.Array, target_entropy: float) -> jax.Array:
    """Return ``-log alpha (mean log pi + target_entropy)``; descent increases alpha if the entropy is too low."""
    return -log_alpha * jax.lax.stop_gradient(log_density + target_entropy)


@functools.cache
def make_updater(rates: Rates) -> Callable[..., tuple[Agent, dict[str, jax.Array]]]:
    """Return a function that maps ``(agent, data, rows (updates, batch), key)`` to the updated agent and metrics."""
    adam = optax.adam(rates.rate)

    def adam_step(slopes: Any, moments: Any, parameters: Any) -> tuple[Any, Any]:
        updates, moments = adam.update(slopes, moments, parameters)
        return optax.apply_updates(parameters, updates), moments

    def update(agent: Agent, batch_and_key: Any) -> tuple[Agent, Any]:
        (actor, critics, log_alpha), (first, second, third) = agent.networks, agent.moments
        batch, key = batch_and_key
        shape = batch.t.shape
        noises = (jax.random.normal(subkey, shape) for subkey in jax.random.split(key))
        target = critic_targets(agent, batch, next(noises), rates.discount)
        loss, slopes = jax.value_and_grad(critic_loss)(critics, batch, target)
        critics, second = adam_step(slopes, second, critics)
        of_actor = jax.value_and_grad(actor_loss, has_aux=True)
        (_, density), slopes = of_actor(actor, critics, log_alpha, batch.o, next(noises))
        actor, first = adam_step(slopes, first, actor)
        slope = jax.grad(temperature_loss)(log_alpha, density, rates.target_entropy * shape[1])
        log_alpha, third = adam_step(slope, third, log_alpha)
        targets = jax.tree.map(lambda old, new: old + rates.tau * (new - old), agent.targets, critics)
        networks = Networks(actor, critics, log_alpha)
        metrics = {
            "critic_loss": loss,
            "entropy": -density,
            "gradient_norm": sum(jnp.sum(leaf**2) for leaf in jax.tree.leaves(slopes)) ** 0.5,
        }
        return Agent(networks, targets, (first, second, third)), metrics

    @jax.jit
    def updates(agent: Agent, data: Batch, rows: Any, key: Any) -> tuple[Agent, Any]:
        def step(agent: Agent, rows_and_key: Any) -> tuple[Agent, Any]:
            batch_rows, key = rows_and_key
            return update(agent, (Batch(*(column[batch_rows] for column in data)), key))

        return jax.lax.scan(step, agent, (rows, jax.random.split(key, len(rows))))

    return updates


sample_actions_compiled = jax.jit(sample_actions)
"""Compiled :func:`sample_actions`."""


def mean_action_parameters(actor: Actor) -> np.ndarray:
    """Return the mean action's parameters in the order of the engine's dense policy: for each layer W, then b."""
    arrays = [array for layer in (*actor.trunk, actor.mean) for array in layer]
    return np.concatenate([np.asarray(array, dtype=float).ravel() for array in arrays])
