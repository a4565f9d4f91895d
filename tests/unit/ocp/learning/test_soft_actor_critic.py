"""Targets and losses of soft actor-critic agree with numbers computed by hand."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ocp.learning.mbpo_networks import (
    Actor,
    Agent,
    Batch,
    Networks,
    Rates,
    action_moments,
    actor_loss,
    begin_agent,
    critic_loss,
    critic_targets,
    make_updater,
    mean_action_parameters,
    sample_actions,
    temperature_loss,
)

ACTOR = Actor((), (jnp.array([[0.5]]), jnp.array([0.1])), (jnp.array([[0.0]]), jnp.array([-1.0])))
"""Actor ``a = 0.5 o + 0.1 + noise / e``."""
CRITICS = ((jnp.array([[[1.0, 2.0]], [[-1.0, 3.0]]]), jnp.array([[0.5], [0.0]])),)
"""Critics ``o + 2 t + 1/2`` and ``-o + 3 t``."""
ALPHA = 0.2


def by_hand(o, noise):
    """Return actions tanh(a) and their log-densities by the change of variables."""
    a = 0.5 * o + 0.1 + noise / np.e
    normal = -0.5 * noise**2 + 1.0 - 0.5 * np.log(2 * np.pi)
    return np.tanh(a), normal - np.log(1 - np.tanh(a) ** 2)


def column(*values: float) -> jnp.ndarray:
    return jnp.array(values)[:, None]


@pytest.mark.costly
def test_densities_are_those_of_the_change_of_variables_and_integrate_to_one():
    o, noise = np.array([0.3, -2.0, 8.0]), np.array([0.4, -1.5, 0.2])
    t, density = sample_actions(ACTOR, column(*o), column(*noise))
    expected = by_hand(o, noise)
    assert t[:, 0] == pytest.approx(expected[0], rel=1e-5)
    assert density == pytest.approx(expected[1], rel=1e-4)
    grid = np.linspace(-6, 6, 4001)
    t, density = sample_actions(ACTOR, jnp.full((4001, 1), 0.3), column(*grid))
    assert np.trapezoid(np.exp(density), t[:, 0]) == pytest.approx(1.0, abs=1e-3)
    _, density = sample_actions(ACTOR, column(100.0), column(0.0))
    assert np.isfinite(density).all()


@pytest.mark.costly
def test_targets_take_the_lesser_critic_the_entropy_and_no_future_after_an_end():
    networks = Networks(ACTOR, CRITICS, jnp.log(ALPHA))
    slow = ((CRITICS[0][0] + 1.0, CRITICS[0][1]),)
    o_next, noise = np.array([0.3, -2.0, 0.3]), np.array([0.4, 1.0, 0.4])
    batch = Batch(
        column(0, 0, 0), column(0, 0, 0), jnp.array([1.0, -2.0, 5.0]), jnp.array([0.0, 0.0, 1.0]), column(*o_next)
    )
    t, density = by_hand(o_next, noise)
    first, second = 2 * o_next + 3 * t + 0.5, 4 * t
    soft = np.minimum(first, second) - ALPHA * density
    expected = np.array([1.0, -2.0, 5.0]) + 0.9 * np.array([1, 1, 0]) * soft
    found = critic_targets(Agent(networks, slow, (None, None, None)), batch, column(*noise), 0.9)
    assert (first < second).tolist() != (first > second).tolist()
    assert found == pytest.approx(expected, rel=1e-5)


@pytest.mark.costly
def test_losses_by_hand():
    o, t, noise = np.array([0.5, -1.0]), np.array([0.2, -0.4]), np.array([0.3, -0.7])
    batch = Batch(column(*o), column(*t), jnp.zeros(2), jnp.zeros(2), column(0, 0))
    target = np.array([1.0, 0.5])
    values = np.array([o + 2 * t + 0.5, -o + 3 * t])
    expected = 0.5 * np.mean((values - target) ** 2, axis=1).sum()
    assert float(critic_loss(CRITICS, batch, jnp.asarray(target))) == pytest.approx(expected, 1e-5)
    action, density = by_hand(o, noise)
    best = np.minimum(o + 2 * action + 0.5, -o + 3 * action)
    loss, mean = actor_loss(ACTOR, CRITICS, jnp.log(ALPHA), column(*o), column(*noise))
    assert float(loss) == pytest.approx(np.mean(ALPHA * density - best), rel=1e-5)
    assert float(mean) == pytest.approx(density.mean(), rel=1e-5)


def test_the_temperature_falls_while_the_entropy_is_above_its_aim():
    """The loss ``-log alpha (log pi + aim)`` has the slope ``-aim - log pi``."""
    slope = jax.grad(temperature_loss)
    assert float(slope(jnp.log(0.2), jnp.array(-1.0), -3.0)) == pytest.approx(4.0)
    assert float(slope(jnp.log(0.2), jnp.array(5.0), -3.0)) == pytest.approx(-2.0)


@pytest.mark.costly
def test_an_update_moves_targets_slowly_and_each_network_by_its_own_loss():
    rates = Rates(rate=1e-2, discount=0.9, tau=0.1, target_entropy=-1.5)
    agent = begin_agent(np.random.default_rng(0), (2, 8, 1), (8,), 0.1, 1.0, 0.2, rates.rate)
    rng = np.random.default_rng(0)
    data = Batch(*(rng.standard_normal(shape).astype("f4") for shape in ((64, 2), (64, 1), (64,), (64,), (64, 2))))
    found, told = make_updater(rates)(agent, data, np.zeros((1, 4), int), jax.random.key(1))
    critics = found.networks.critics
    for old, new, slow in zip(
        *(jax.tree.leaves(tree) for tree in (agent.targets, critics, found.targets)), strict=True
    ):
        assert np.asarray(slow) == pytest.approx(np.asarray(0.9 * old + 0.1 * new), abs=1e-6)
        # Adam's first step has the size of the rate.
        assert np.abs(new - old).max() == pytest.approx(1e-2, rel=1e-2)
    entropy = float(told["entropy"][0])
    change = float(found.networks.log_alpha - agent.networks.log_alpha)
    assert change == pytest.approx(-1e-2 * np.sign(entropy + 1.5), rel=1e-3)


@pytest.mark.costly
def test_theta_is_laid_out_as_the_engine_s_dense_policy():
    import casadi as ca

    from dynamics.batch import dense_policy

    x, p = ca.SX.sym("x", 3), ca.SX.sym("p", 0)
    observe = ca.Function("observe", [x, p], [x])
    policy = dense_policy(observe, (5, 4), [-1.0, -1.0], [1.0, 1.0])
    agent = begin_agent(np.random.default_rng(3), (3, 5, 4, 2), (8,), 1.0, 0.5, 0.2, 1e-3)
    theta = mean_action_parameters(agent.networks.actor)
    assert theta.shape == (policy.n_theta,)
    o = np.random.default_rng(0).standard_normal((6, 3))
    mean, spread = action_moments(agent.networks.actor, jnp.asarray(o))
    assert policy.mean_actions(theta, o) == pytest.approx(np.asarray(mean), abs=1e-5)
    assert np.exp(spread) == pytest.approx(np.full((6, 2), 0.5))
