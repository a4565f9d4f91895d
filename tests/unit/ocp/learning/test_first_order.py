"""The gradient of first-order policy gradients agrees with differences of the mean return."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Adaptive, Barrier, ContactLaw
from dynamics.systems import Signal
from ocp.learning.experiment import Experiment
from ocp.learning.protocol import State
from ocp.learning.unroll_gradients import FOPG
from ocp.learning.unrolling import unroll_episodes
from ocp.problem.task import Task
from tests.unit.dynamics.batch.rollout_cases import wall

LAWS = [Barrier(1e-2), Adaptive("quartic"), Adaptive("gaussian", sigma=0.1)]
UNROLL, SAMPLES = 12, 32
PLAIN = {"rate": 1.0, "optimiser": "plain"}


def before_the_wall() -> Task:
    """Return a task of keeping a mass near a wall at 0; episodes end where it is too fast or too far."""
    system = wall()
    x, chance = system.x, ca.SX.sym("chance", 2)
    return Task(
        name="before the wall",
        system=system,
        parameters=system.parameters,
        horizon=40,
        start=ca.vertcat(0.1, -0.5) + 0.3 * chance,
        chance=chance,
        reward=-((system.x_next[0] - 0.2) ** 2) - 0.01 * ca.sumsqr(system.u) + system.x_next[1],
        observation=ca.vertcat(x[0], x[1], ca.sin(3 * x[0])),
        observations=(Signal("x", "m"), Signal("v", "m/s"), Signal("wave", "1")),
        lower=np.array([-4.0]),
        upper=np.array([6.0]),
        done=ca.logic_or(ca.fabs(x[1]) > 0.9, x[0] > 0.6),
    )


def set_up(hidden: tuple[int, ...], law: ContactLaw, **settings: str) -> tuple[Experiment, State]:
    """Return an experiment and a state of learning whose observations are normalised by constants."""
    algorithm = FOPG(samples=SAMPLES, unroll=UNROLL, **PLAIN, sigma=0.3)
    experiment = Experiment(
        task=before_the_wall(),
        algorithm=replace(algorithm, **settings),
        law=law,
        hidden=hidden,
        initial=1.0,
        discount=0.97,
        normalise=False,
        threads=1,
    )
    state = algorithm.begin(experiment)
    seen = {"normaliser.n": np.array(9.0), "normaliser.mean": np.array([0.2, -0.1, 0.3])}
    return experiment, {**state, **seen, "normaliser.m2": np.array([0.5, 3.0, 2.0])}


@pytest.mark.cheap_cases("affine-barrier", "2 x 64-gaussian")
@pytest.mark.parametrize("law", LAWS, ids=["barrier", "quartic", "gaussian"])
@pytest.mark.parametrize("hidden", [(), (64, 64)], ids=["affine", "2 x 64"])
def test_the_step_is_along_the_gradient_of_the_mean_return(hidden, law):
    """They agree to 1e-5 along random directions, with episodes that end early and normalised observations."""
    experiment, state = set_up(hidden, law)
    changed, row = experiment.algorithm.iterate(experiment, state, 0)
    gradient = changed["theta"] - state["theta"]
    assert row["gradient_norm"] == pytest.approx(np.linalg.norm(gradient), rel=1e-12)
    noise = experiment.noise(0.3, 0, "actions")

    def found(theta):
        return unroll_episodes(experiment, {**state, "theta": theta}, state["starts.x"], UNROLL, noise=noise)

    lived = found(state["theta"]).lived
    assert 0 < (lived < UNROLL).sum() < SAMPLES, "some end before, some do not"
    rng = np.random.default_rng(0)
    for _ in range(3):
        direction = rng.standard_normal(gradient.size)
        direction /= np.linalg.norm(direction)
        step = 1e-5 * direction
        up, down = found(state["theta"] + step), found(state["theta"] - step)
        assert (up.lived == lived).all() and (down.lived == lived).all(), "no kink between"
        difference = (up.value - down.value).mean() / 2e-5
        assert gradient @ direction == pytest.approx(difference, rel=1e-5, abs=1e-7)


def test_the_variance_told_is_that_of_the_samples():
    experiment, state = set_up((), LAWS[0])
    _, row = experiment.algorithm.iterate(experiment, state, 0)
    noise = experiment.noise(0.3, 0, "actions")
    found = unroll_episodes(experiment, state, state["starts.x"], UNROLL, noise=noise, gradient=True)
    assert found.gradient is not None
    by_hand = np.cov(found.gradient.T, ddof=1).trace()
    assert row["gradient_variance"] == pytest.approx(by_hand, rel=1e-10)
    assert row["return_mean"] == pytest.approx(found.value.mean(), rel=1e-12)


def test_gradient_smoothing_keeps_exact_states():
    """Returns are those of mu = 1e-10; the gradient differs from those of the sharp and of the smoothed rollout."""
    told = {}
    for name, law, smoothing in (
        ("sharp", Barrier(1e-10), "rollout"),
        ("gradient", Barrier(1e-2), "gradient"),
        ("rollout", Barrier(1e-2), "rollout"),
    ):
        experiment, state = set_up((), law, smoothing=smoothing)
        changed, row = experiment.algorithm.iterate(experiment, state, 0)
        told[name] = row["return_mean"], changed["theta"] - state["theta"]
    assert told["gradient"][0] == pytest.approx(told["sharp"][0], rel=1e-12)
    assert told["rollout"][0] != pytest.approx(told["sharp"][0], rel=1e-4)
    for other in ("sharp", "rollout"):
        assert np.abs(told["gradient"][1] - told[other][1]).max() > 1e-3


def test_gradient_smoothing_without_smoothing_is_the_plain_gradient():
    """If the gradient's law is that of the states, both kinds of smoothing give the same step."""
    steps = []
    for smoothing in ("gradient", "rollout"):
        experiment, state = set_up((), Barrier(1e-10), smoothing=smoothing)
        changed, _ = experiment.algorithm.iterate(experiment, state, 0)
        steps.append(changed["theta"] - state["theta"])
    assert steps[0] == pytest.approx(steps[1], rel=1e-6, abs=1e-9)
