"""Environments: Gymnasium's checker, agreement of single and vector ones with the task, rejected values."""

from __future__ import annotations

import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from dynamics.batch import dense_policy
from dynamics.laws import LAWS
from ocp.learning.rollouts import TaskRollouts
from problems.tasks import registry
from reports.environments.environment import TaskEnv
from reports.environments.world import LARGEST
from tests.unit.reports.environments.made import IDS, SOFT, made, many


def test_every_task_is_registered():
    assert set(IDS) == set(registry.names())
    for name in IDS.values():
        assert gymnasium.spec(name).vector_entry_point is not None


@pytest.mark.costly
def test_a_module_before_the_name_registers_by_itself():
    """Gymnasium reads no entry points, so that the module must be in the name or be imported before."""
    code = "import gymnasium\nprint(gymnasium.make('reports.environments:centralpath/BallThrow-v0').spec.id)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "centralpath/BallThrow-v0", done.stderr


@pytest.mark.costly_cases("hopper")
@pytest.mark.parametrize("task", ["ball-throw", "hopper"])
def test_gymnasiums_check_passes_without_a_warning(task: str):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(made(task, render_mode="rgb_array").unwrapped)


@pytest.mark.slow
def test_gymnasiums_check_passes_for_the_half_cheetah():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(made("half-cheetah", render_mode="rgb_array").unwrapped)


def by_hand(env: TaskEnv, seed: int, actions: np.ndarray) -> list[tuple[np.ndarray, float]]:
    """Return states and rewards of an episode, computed with the task's functions and the law's step."""
    task, step, p = env.world.task, env.world.step, env.world.p
    x = task.reset(1, np.random.default_rng(np.random.PCG64(np.random.SeedSequence(seed))))[0]
    told = []
    for action in actions:
        u = task.lower + (task.upper - task.lower) * (action + 1) / 2
        after = np.array(step.solve(x, u, p)[0]).ravel()
        told.append((after, float(task.rewards(x, u, after, task.parameters.values))))
        x = after
    return told


@pytest.mark.costly
@pytest.mark.parametrize(
    ("task", "given"),
    [("hopper", {}), pytest.param("half-cheetah", {"spheres": "legs"}, marks=pytest.mark.slow)],
)
def test_one_and_many_agree_with_the_tasks_own_step(task: str, given: dict[str, str]):
    env, steps, n, scale = made(task, **given).unwrapped, 10, 4, 0.01
    assert isinstance(env, TaskEnv)
    together = many(task, n, **given)
    nu = env.action_space.shape[0]
    actions = scale * np.random.default_rng(0).uniform(-1, 1, (steps, n, nu))
    seen, _ = together.reset(seed=7)
    observations, rewards = [seen], []
    for each in actions:
        seen, reward, terminated, truncated, info = together.step(each)
        assert not (terminated | truncated | info["unsolved"]).any()
        observations.append(seen)
        rewards.append(reward)
    for i in range(n):
        alone, _ = env.reset(seed=7 + i)
        np.testing.assert_array_equal(alone, observations[0][i])
        for k, (x, reward) in enumerate(by_hand(env, 7 + i, actions[:, i])):
            alone, gained, *_, info = env.step(actions[k, i])
            np.testing.assert_allclose(env.state, x, rtol=0, atol=1e-9)
            np.testing.assert_allclose(observations[k + 1][i], alone, rtol=0, atol=1e-9)
            assert gained == pytest.approx(reward, abs=1e-9)
            assert rewards[k][i] == pytest.approx(reward, abs=1e-9)
            assert info["height"] == pytest.approx(x[1], abs=1e-9)


@pytest.mark.costly
def test_many_are_gymnasiums_own_row_of_single_ones_over_falls_and_new_starts():
    row = gymnasium.make_vec(IDS["hopper"], num_envs=4, vectorization_mode="sync")
    together = many("hopper", 4)
    seen = [env.reset(seed=1)[0] for env in (row, together)]
    np.testing.assert_array_equal(*seen)
    rng, falls = np.random.default_rng(0), 0
    for _ in range(40):
        actions = rng.uniform(-0.02, 0.02, (4, 3))
        (*ours, told), (*theirs, said) = together.step(actions), row.step(actions)
        for mine, other in zip(ours, theirs, strict=True):
            np.testing.assert_allclose(mine, other, rtol=0, atol=1e-9)
        assert set(told) == set(said)
        for key, values in told.items():
            np.testing.assert_allclose(values, said[key], rtol=0, atol=1e-9)
        falls += int(ours[2].sum())
    assert falls > 5


@pytest.mark.costly
def test_returns_are_those_of_the_engines_episodes():
    """An affine policy gives the same returns on the environments and in compiled rollouts."""
    env, n = many("hopper", 16, horizon=25), 16
    world = env.world
    task, nu, no = world.task, 3, world.observation_space.shape[0]
    policy = dense_policy(task.observe, hidden=(), lower=task.lower, upper=task.upper)
    theta = np.random.default_rng(4).normal(0, 0.01, nu * (no + 1))
    seen, _ = env.reset(seed=0)
    expected = TaskRollouts(task, world.law, policy, task.horizon)(env.state, theta)
    W, b = theta[: nu * no].reshape(nu, no), theta[nu * no :]
    returns, lived, going = np.zeros(n), np.zeros(n, int), np.ones(n, bool)
    while going.any():
        seen, reward, terminated, truncated, _ = env.step(np.tanh(seen @ W.T + b))
        returns, lived = returns + going * reward, lived + going
        going &= ~(terminated | truncated)
    assert lived.min() < task.horizon
    np.testing.assert_array_equal(lived, expected.lived)
    np.testing.assert_allclose(returns, expected.value, rtol=0, atol=1e-9)


@pytest.mark.one_case_in(2)
@pytest.mark.parametrize("contact", ["exact", *SOFT])
def test_any_law_by_name_and_its_settings(contact: str):
    given = {"contact": contact, "contact_settings": SOFT.get(contact)}
    env, together = made("ball-throw", **given), many("ball-throw", 3, **given)
    law = LAWS[contact](**SOFT.get(contact, {}))
    assert env.unwrapped.world.law.settings() == law.settings()
    throws = np.array([[0.4, -0.4], [-0.3, 0.2], [-0.9, -0.6]])
    together.reset(seed=1)
    ends, rewards, terminated, *_ = together.step(throws)
    assert terminated.all()
    for throw, end, reward in zip(throws, ends, rewards, strict=True):
        env.reset(seed=1)
        seen, alone, over, *_ = env.step(throw)
        np.testing.assert_allclose(seen, end, rtol=0, atol=1e-9)
        assert alone == pytest.approx(reward, abs=1e-9)
        assert over


def test_laws_differ_where_the_ball_bounces():
    ends = []
    for given in ({}, {"contact": "barrier", "contact_settings": {"mu": 1e-2}}):
        env = made("ball-throw", **given)
        env.reset(seed=0)
        ends.append(env.step(np.array([0.4, -0.4]))[0])
    assert np.abs(ends[0] - ends[1]).max() > 1e-3


def test_a_throw_is_one_action_scaled_to_angle_and_speed():
    env = made("ball-throw", render_mode="rgb_array")
    env.reset(seed=0)
    angle, speed = 0.6, 3.0
    action = np.array([angle / 1.5, speed / 5 - 1])
    seen, reward, terminated, truncated, info = env.step(action)
    np.testing.assert_allclose(seen[:4], [2.476, 0.5547, 2.476, 0.4327], atol=2e-4)
    assert reward == pytest.approx(0, abs=1e-6)
    assert terminated and not truncated and info == {"unsolved": False}
    fixed = made("ball-throw", fixed_speed=1, speed=speed)
    fixed.reset(seed=0)
    np.testing.assert_allclose(fixed.step(action[:1])[0], seen, atol=1e-12)


@pytest.mark.costly
def test_spaces_are_as_wide_as_what_is_acted_and_seen():
    env = made("hopper").unwrapped
    low, high = env.observation_space.low, env.observation_space.high
    assert env.action_space == gymnasium.spaces.Box(-1, 1, (3,), np.float64)
    np.testing.assert_array_equal(-low, high)
    np.testing.assert_array_equal(high, [LARGEST] * 5 + [10.0] * 6)
    env.reset(seed=0)
    seen, *_ = env.step(np.ones(3))
    assert seen in env.observation_space and np.abs(seen[5:]).max() == 10
    env = many("ball-throw", 2)
    assert env.action_space.shape == (2, 2) and env.observation_space.shape == (2, 5)
    assert env.single_observation_space.low[4] == 0 and env.single_observation_space.high[4] == 1
    first, _ = env.reset(seed=0)
    assert first in env.observation_space and first[0, 4] == 1
    assert env.step(np.zeros((2, 2)))[0] in env.observation_space


@pytest.mark.costly
def test_actions_beyond_the_bounds_are_clamped():
    env = made("hopper").unwrapped
    ends = []
    for size in (1.0, 5.0):
        env.reset(seed=3)
        ends.append(env.step(np.full(3, size))[:2])
    np.testing.assert_array_equal(ends[0][0], ends[1][0])
    assert ends[0][1] == ends[1][1]


@pytest.mark.costly
def test_time_truncates_and_a_fall_terminates():
    env = made("hopper", horizon=3)
    env.reset(seed=0)
    ends = [env.step(np.zeros(3))[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]
    env = made("hopper")
    env.reset(seed=0)
    seen, _, terminated, truncated, _ = env.step(np.ones(3))
    assert terminated and not truncated
    assert abs(seen[1]) >= 0.2 or seen[0] <= 0.7


@pytest.mark.costly
def test_same_seed_same_numbers_and_threads_change_none():
    rng = np.random.default_rng(2)
    actions = rng.uniform(-0.05, 0.05, (15, 40, 3))
    told = []
    for threads in (1, 2, 1):
        env = many("hopper", 40, threads=threads)
        first, _ = env.reset(seed=11)
        told.append([first, *(part for u in actions for part in env.step(u)[:4])])
    for other in told[1:]:
        for ours, theirs in zip(told[0], other, strict=True):
            np.testing.assert_array_equal(ours, theirs)
    few = many("hopper", 3)
    assert few.reset(seed=11)[0].tolist() == told[0][0][:3].tolist()
    assert not np.array_equal(few.reset()[0], told[0][0][:3])
