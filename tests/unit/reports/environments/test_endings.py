"""Ends of episodes in environments, pictures, and rejected values."""

from __future__ import annotations

import builtins
import importlib
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode

from dynamics.batch import NonFinite, StepFunction, Steps
from ocp.errors import InputError
from problems.tasks import registry
from reports.environments import world as world_module
from reports.environments.environment import TaskEnv, TaskVectorEnv
from reports.environments.world import LARGEST
from tests.unit.reports.environments.made import made, many


@pytest.mark.costly
def test_who_has_ended_starts_anew_at_the_next_step():
    env = many("hopper", 2, horizon=5)
    env.reset(seed=0)
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    fall = np.array([np.zeros(3), np.ones(3)])
    _, _, terminated, _, info = env.step(fall)
    assert terminated.tolist() == [False, True]
    seen, reward, terminated, truncated, info = env.step(fall)
    assert reward[1] == 0 and not terminated.any() and not truncated.any()
    assert info["_speed"].tolist() == [True, False] and info["speed"][1] == 0
    task = registry.get("hopper")
    rng = gymnasium.utils.seeding.np_random(1)[0]
    second = task.reset(2, rng)[1]
    np.testing.assert_allclose(env.state[1], second, atol=1e-15)
    np.testing.assert_array_equal(seen[1], np.append(second[1:6], second[6:]))
    # The first continues and is truncated three steps later; the second has been reset.
    for _ in range(3):
        *_, truncated, info = env.step(np.zeros((2, 3)))
    assert truncated.tolist() == [True, False]


@pytest.mark.costly_cases("lost")
@pytest.mark.parametrize("kind", ["lost", "overflow"])
def test_a_step_without_solution_ends_its_episode_and_says_so(kind: str, monkeypatch):
    env = made("hopper").unwrapped
    assert isinstance(env, TaskEnv)
    env.reset(seed=0)
    x, solve = env.state, env.world.step.solve

    def failing(*given):
        x_next, lam, gap, error = solve(*given)
        bad = (x_next, 1.0) if kind == "lost" else (10 * LARGEST, error)
        return bad[0], lam, gap, bad[1]

    monkeypatch.setitem(env.world.step.__dict__, "solve", failing)
    seen, reward, terminated, truncated, info = env.step(np.zeros(3))
    assert terminated and not truncated and info["unsolved"]
    assert reward == 0
    np.testing.assert_array_equal(env.state, x)
    assert seen in env.observation_space


class Forgetful(StepFunction):
    """Step function that reports rows 0 and 1 as not solved."""

    def __call__(self, x, u, p=None):
        found = super().__call__(x, u, p)
        found.x_next[:2] = np.nan
        return Steps(found.x_next, found.lam, NonFinite(2, np.array([0, 1])))


@pytest.mark.costly
def test_many_solve_again_who_is_lost_and_end_who_stays_so(monkeypatch):
    """The engine alone fails at state 0, every solver fails at state 1, and none at state 2."""
    right = many("hopper", 3)
    monkeypatch.setattr(world_module, "StepFunction", Forgetful)
    env = many("hopper", 3)
    assert isinstance(env, TaskVectorEnv)
    for each in (right, env):
        each.reset(seed=0)
    x, solve = env.state, env.world.step.solve

    def search(state, *given):
        x_next, lam, gap, error = solve(state, *given)
        return x_next, lam, gap, 1.0 if np.array_equal(state, x[1]) else error

    monkeypatch.setitem(env.world.step.__dict__, "solve", search)
    _, expected, *_ = right.step(np.zeros((3, 3)))
    _, reward, terminated, _, info = env.step(np.zeros((3, 3)))
    assert info["unsolved"].tolist() == terminated.tolist() == [False, True, False]
    np.testing.assert_allclose(reward, np.where(terminated, 0.0, expected), atol=1e-9)
    np.testing.assert_allclose(env.state[[0, 2]], right.state[[0, 2]], atol=1e-9)
    np.testing.assert_array_equal(env.state[1], x[1])


@pytest.mark.costly
def test_pictures_show_the_body_and_the_ground():
    env = made("hopper", render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    assert first.shape == (400, 640, 3) and first.dtype == np.uint8
    env.step(np.zeros(3))
    second = env.render()
    assert (first != second).any()
    # The ground is a grey area, the body is blue.
    grey, blue = first[325:350].astype(int), first.astype(int)
    assert (np.abs(grey - 217).max(axis=2) < 3).mean() > 0.7
    assert (blue[..., 2] - blue[..., 0] > 60).sum() > 500
    both = many("hopper", 2, render_mode="rgb_array")
    both.reset(seed=0)
    frames = both.render()
    assert len(frames) == 2
    np.testing.assert_array_equal(frames[0], first)
    assert made("hopper", render_mode="rgb_array").metadata["render_fps"] == 20


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"contact": "exct"}, "unknown contact law 'exct'.*did you mean 'exact'"),
        ({"contact": "barrier", "contact_settings": {"mu": -1.0}}, "mu must be a number > 0"),
        ({"contact": "barrier", "contact_settings": {"nu": 1.0}}, "no setting 'nu'"),
        ({"horizon": 0}, "horizon"),
        ({"horizn": 5}, "unknown parameter 'horizn'.*did you mean 'horizon'"),
        ({"task": "hoper"}, "unknown task 'hoper'"),
        ({"num_envs": 0}, "num_envs must be a whole number >= 1, got 0"),
        ({"num_envs": 1.5}, "num_envs"),
        ({"render_mode": "human"}, "render_mode must be 'rgb_array' or None, got 'human'"),
    ],
)
def test_bad_input_is_said_in_one_sentence(given: dict, told: str):
    one = {key: value for key, value in given.items() if key != "num_envs"}
    with pytest.raises(InputError, match=told):
        TaskVectorEnv(**{"task": "ball-throw", "num_envs": 2, **given})
    if one:
        with pytest.raises(InputError, match=told):
            TaskEnv(**{"task": "ball-throw", **one})


def test_what_an_episode_cannot_do_is_refused():
    for env in (made("ball-throw").unwrapped, many("ball-throw", 1)):
        actions = np.zeros(env.action_space.shape)
        with pytest.raises(ResetNeeded, match="call reset"):
            env.step(actions)
        env.reset(seed=0)
        with pytest.raises(InputError, match=r"render_mode='rgb_array'"):
            env.render()
        with pytest.raises(InputError, match="shape"):
            env.step(np.zeros(7))
        with pytest.raises(InputError, match="finite"):
            env.step(np.nan * actions)
    env = made("ball-throw", render_mode="rgb_array").unwrapped
    with pytest.raises(ResetNeeded, match="nothing to draw"):
        env.render()
    env.reset(seed=0)
    env.step(np.zeros(2))
    with pytest.raises(ResetNeeded, match="the episode has ended"):
        env.step(np.zeros(2))


def test_without_gymnasium_the_import_says_what_to_install(monkeypatch):
    real = builtins.__import__

    def without(name, *rest, **more):
        if name.startswith("gymnasium"):
            raise ImportError(name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    monkeypatch.delitem(sys.modules, "reports.environments")
    with pytest.raises(ImportError, match=r"pip install 'centralpath\[gym\]'"):
        importlib.import_module("reports.environments")
