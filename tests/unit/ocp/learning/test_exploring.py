"""Transitions under policies agree with the closed form of a mass on a spring."""

from __future__ import annotations

import numpy as np
import pytest

from ocp.errors import InputError
from ocp.learning.explorer import Explorer, random_transitions, squash
from tests.unit.ocp.learning.spring_mass import D, K, M, following, spring_task


def test_a_step_is_the_closed_forms_with_reward_end_and_touch():
    explorer = Explorer(spring_task())
    x = np.array([[0.2, 0.5], [0.01, -1.0], [0.29, 3.0]])
    u = np.array([[1.0], [-2.0], [6.0]])
    seen = explorer.step(x, u)
    expected = following(x, u, M, K, D)
    assert seen.x_next == pytest.approx(expected, abs=1e-7)
    assert seen.reward == pytest.approx(-(expected[:, 0] ** 2) - 0.1 * u[:, 0] ** 2, abs=1e-6)
    assert seen.solved.all()
    assert seen.touched.tolist() == [False, True, False]
    assert seen.ended.tolist() == [False, False, True]


def test_episodes_begin_again_where_they_ended_and_when_they_are_old():
    explorer = Explorer(spring_task(horizon=6))
    x = np.array([[0.2, 0.5], [0.29, 3.0], [0.2, 0.5]])
    seen = explorer.step(x, np.full((3, 1), 2.0))
    after, age = explorer.advance(seen, np.array([2, 2, 5]), np.random.default_rng(3))
    assert (after[0] == seen.x_next[0]).all()
    assert age.tolist() == [3, 0, 0]
    fresh = explorer.task.reset(3, np.random.default_rng(3))
    assert (after[1:] == fresh[1:]).all()


def test_values_of_parameters_reach_the_steps():
    explorer = Explorer(spring_task(), values={"k": 7.0})
    x, u = np.array([[0.2, 0.5]]), np.array([[1.0]])
    assert explorer.step(x, u).x_next == pytest.approx(following(x, u, M, 7.0, D), abs=1e-7)


def test_random_policies_give_transitions_of_the_system_the_same_for_a_seed():
    explorer = Explorer(spring_task(), threads=1)
    found, touched = random_transitions(explorer, 330, seed=4)
    assert len(found) == len(touched) == 330
    assert found.x_next == pytest.approx(following(found.x, found.u, M, K, D), abs=1e-6)
    assert (touched == (found.x_next[:, 0] <= 1e-6)).all() and 10 < touched.sum() < 320
    assert found.u.std() > 0.1 and (found.u > -2).all() and (found.u < 6).all()
    assert (found.x[50:100] == found.x_next[:50]).all(axis=1).mean() > 0.5
    again, _ = random_transitions(Explorer(spring_task(), threads=2), 330, seed=4)
    assert (again.x_next == found.x_next).all()
    other, _ = random_transitions(explorer, 330, seed=5)
    assert not (other.u == found.u).any()
    with pytest.raises(InputError, match="n must be a whole number >= 1, got 0"):
        random_transitions(explorer, 0, seed=4)


def test_inputs_are_squashed_between_the_bounds():
    a = np.array([[0.0], [1e3], [-1e3], [0.5]])
    expected = [2.0, 6.0, -2.0, 2 + 4 * np.tanh(0.5)]
    assert squash(spring_task(), a)[:, 0] == pytest.approx(expected)
