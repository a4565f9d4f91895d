"""Critics: targets by hand, gradients with a terminal value, and values in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynamics.batch import Gaussian
from ocp.errors import InputError
from ocp.learning.critic import Critic
from ocp.learning.experiment import Experiment
from ocp.learning.protocol import State
from ocp.learning.unroll_gradients import FOPG, SHARP_LAW
from ocp.learning.unrolling import unroll_episodes
from tests.unit.ocp.learning.scalar import A, B, experiment, scalar
from tests.unit.ocp.learning.test_first_order import PLAIN, SAMPLES, UNROLL, set_up

UNITS = 5


def with_weights(critic: Critic, e: Experiment, state: State) -> State:
    """Return the state of learning with random weights of the critic."""
    begun = critic.begin(e)
    theta = np.random.default_rng(4).standard_normal(begun["critic.theta"].size)
    return {**state, **begun, "critic.theta": theta}


def test_targets_by_hand():
    """Targets are right for episodes that go on, that end early, and that end at the last state."""
    steps, discount, critic = 4, 0.5, Critic(units=UNITS)
    e = experiment(FOPG(), task=scalar(horizon=9, done=1.2), discount=discount)
    seen = {"normaliser.n": np.array(4.0), "normaliser.mean": np.array([0.2]), "normaliser.m2": np.array([1.0])}
    state = with_weights(critic, e, {**e.algorithm.begin(e), **seen, "theta": np.array([0.3, 0.1])})
    noise, x0 = Gaussian(0.4, 5), np.linspace(-0.5, 1.1, 20)
    w, found = noise.draw(20, steps, 1)[..., 0], unroll_episodes(e, state, x0[:, None], steps, noise=noise)
    targets = critic.targets(e, state, found, noise)
    sizes = np.cumsum([UNITS, UNITS, UNITS**2, UNITS, UNITS])
    W1, b1, W2, b2, W3, b3 = np.split(state["critic.theta"], sizes)
    ends = set()
    for i, x in enumerate(x0):
        rewards, over = [], False
        while len(rewards) < steps and not over:
            u = 2 * np.tanh(0.3 * (x - 0.2) / 0.5 + 0.1 + w[i, len(rewards)])
            x = A * x + B * u
            rewards.append(-((x - 1) ** 2) - 0.1 * u**2)
            over = x > 1.2
        ends.add((len(rewards), bool(over)))
        hidden = np.tanh(W2.reshape(UNITS, UNITS) @ np.tanh(W1 * (x - 0.2) / 0.5 + b1) + b2)
        togo = 0.0 if over else (W3 @ hidden + b3[0]) / (1 - discount)
        assert np.isnan(targets[i, len(rewards) :]).all()
        for t in reversed(range(len(rewards))):
            togo = rewards[t] + discount * togo
            assert targets[i, t] == pytest.approx(togo, rel=1e-12)
    assert ends >= {(steps, False), (steps, True), (1, True)}


@pytest.mark.costly_cases("affine-rollout", "2 x 8-rollout")
@pytest.mark.parametrize("smoothing", ["rollout", "gradient"])
@pytest.mark.parametrize("hidden", [(), (8, 8)], ids=["affine", "2 x 8"])
def test_the_step_is_along_the_gradient_of_return_and_value(hidden, smoothing):
    """The step equals differences of the mean return plus value under the sharp law; some episodes end early."""
    critic = Critic(units=UNITS)
    e, state = set_up(hidden, SHARP_LAW)
    state = with_weights(critic, e, state)
    settings = {"samples": SAMPLES, "unroll": UNROLL, "sigma": 0.3, **PLAIN}
    gradient, alone = (
        FOPG(smoothing=smoothing, critic=units, **settings).iterate(e, state, 0)[0]["theta"] - state["theta"]
        for units in (UNITS, 0)
    )
    noise = e.noise(0.3, 0, "actions")

    def gained(theta):
        found = unroll_episodes(e, {**state, "theta": theta}, state["starts.x"], UNROLL, noise=noise)
        x = found.states[:, -1]
        over = (np.abs(x[:, 1]) > 0.9) | (x[:, 0] > 0.6)
        assert 0 < over.sum() < SAMPLES
        worth = np.where(over, 0.0, 0.97**UNROLL * critic.value(e, state, x))
        return (found.value + worth).mean(), over

    rng = np.random.default_rng(0)
    for _ in range(3):
        direction = rng.standard_normal(gradient.size)
        direction /= np.linalg.norm(direction)
        (up, one), (down, other) = (gained(state["theta"] + s * direction) for s in (1e-5, -1e-5))
        assert (one == other).all(), "no kink between"
        assert gradient @ direction == pytest.approx((up - down) / 2e-5, rel=1e-5, abs=1e-7)
        assert abs((gradient - alone) @ direction) > 1e-3, "and the critic has its part in it"


@pytest.mark.costly
def test_the_value_of_a_linear_law_is_found():
    """For u = k x and the reward -(x+ - 1)² - u² / 10 the value is a x² + b x + c in closed form."""
    k, discount, steps, critic = -0.6, 0.9, 4, Critic(units=16)
    wide = np.array([1e3])
    task = replace(scalar(horizon=9), lower=-wide, upper=wide)
    e = experiment(FOPG(), task=task, discount=discount)
    state = {**e.algorithm.begin(e), **critic.begin(e), "theta": np.array([k, 0.0]) / wide}
    x = np.linspace(-1, 1, 21)
    assert (critic.value(e, state, x[:, None]) == 0).all()
    noise, errors = Gaussian(1e-9, 0), []
    for i in range(150):
        x0 = np.random.default_rng(i).uniform(-1, 1, (32, 1))
        found = unroll_episodes(e, state, x0, steps, noise=noise)
        learned, row = critic.learn(e, state, state, found, noise, i)
        state |= learned
        errors.append(row["critic_error"])
    f = A + B * k
    a, b = -(f**2 + 0.1 * k**2) / (1 - discount * f**2), 2 * f / (1 - discount * f)
    exact = a * x**2 + b * x - 1 / (1 - discount)
    spread = exact.max() - exact.min()
    assert np.abs(critic.value(e, state, x[:, None]) - exact).max() < 0.03 * spread
    assert errors[0] > 2 and np.mean(errors[-20:]) < 0.02 * spread


def test_what_was_seen_does_not_change_values():
    """With new statistics of the observations and no learning, the value is the same function of x."""
    critic = Critic(units=UNITS, steps=0)
    e, state = set_up((), SHARP_LAW)
    state, noise = with_weights(critic, e, state), e.noise(0.3, 0, "actions")
    found = unroll_episodes(e, state, state["starts.x"], UNROLL, noise=noise)
    after = {**state, "normaliser.mean": np.full(3, 0.4), "normaliser.m2": np.array([8.0, 1.0, 5.0])}
    moved = {**after, **critic.learn(e, state, after, found, noise, 0)[0]}
    x = found.states[:, 0]
    assert critic.value(e, moved, x) == pytest.approx(critic.value(e, state, x), rel=1e-10)
    assert critic.value(e, after, x) != pytest.approx(critic.value(e, state, x), rel=0.1)


def test_nothing_is_to_come_after_ends():
    """Where all episodes have ended, the value adds nothing to the gradient."""
    critic = Critic(units=UNITS)
    e = experiment(FOPG(), task=scalar(horizon=9, done=-5.0), discount=0.9)
    state = with_weights(critic, e, e.algorithm.begin(e))
    found = unroll_episodes(e, state, np.ones((4, 1)), 3)
    assert (critic.terminal_gradient(e, state, found) == np.zeros((4, 1))).all()


@pytest.mark.parametrize(
    ("critic", "given", "words"),
    [
        (-1, {}, "critic must be a whole number >= 0, got -1"),
        (1.5, {}, "critic must be a whole number >= 0, got 1.5"),
        (8, {"discount": 1.0}, "a critic needs a discount below 1, got 1"),
        (8, {"task": scalar(horizon=3)}, "unrolls of 3 steps are whole episodes of scalar; sho"),
    ],
)
def test_critics_that_cannot_be_are_refused(critic, given, words):
    with pytest.raises(InputError, match=words):
        e = experiment(FOPG(unroll=3, critic=critic), **{"task": scalar(horizon=9), "discount": 0.9, **given})
        e.algorithm.begin(e)
