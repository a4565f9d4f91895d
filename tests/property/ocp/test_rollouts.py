"""Rolled-out trajectories and costs agree with simulations written by hand."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics.contact import Barrier, ContactLaw, Exact
from ocp import Gains, Problem, roll_out
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import roll_on
from problems import get
from tests.examples import settings

seeds = given(seed=st.integers(0, 2**32 - 1))
some = settings(max_examples=20, deadline=None)
MU = {"exact": 0.0, "barrier": 1e-3}
N = 12


def law_of(name: str) -> ContactLaw:
    return Exact() if name == "exact" else Barrier(mu=MU[name])


@functools.cache
def problem_of(name: str) -> Problem:
    return get(name, N=N)


@functools.cache
def step_of(name: str, law: str):
    return law_of(law).close(problem_of(name).system)


def values_of(problem: Problem) -> dict[str, float]:
    return {parameter.name: parameter.value for parameter in problem.parameters}


def contact(z: float, F: float, mu: float) -> float:
    """Return the root lam >= 0 of ``lam (z + F lam) = mu``."""
    return (math.sqrt(z * z + 4 * F * mu) - z) / (2 * F)


def wall_by_hand(u: np.ndarray, mu: float) -> tuple[np.ndarray, np.ndarray, float]:
    m, h, x, v = 1.0, 0.1, 1.0, 0.0
    states, impulses, cost = [(x, v)], [], 0.0
    for impulse in u:
        cost += (x + 0.5) ** 2 + 0.1 * v**2 + 0.01 * impulse**2
        lam = contact(x + h * (v + impulse / m), h / m, mu)
        v += (impulse + lam) / m
        x += h * v
        states.append((x, v))
        impulses.append(lam)
    return np.array(states), np.array(impulses), cost + 10 * (x + 0.5) ** 2


def push_by_hand(u: np.ndarray, mu: float) -> tuple[np.ndarray, np.ndarray, float]:
    M, K, h, qu, qa, before = 1.0, 100.0, 0.1, 0.0, -0.5, -0.5
    states, impulses, cost = [(qu, qa)], [], 0.0
    for command in u:
        cost += (qu - 1) ** 2 + 0.1 * (command - before) ** 2
        lam = contact(qu - command - 0.2, h / M + 1 / (h * K), mu)
        qu, qa, before = qu + h * lam / M, command - lam / (h * K), command
        states.append((qu, qa))
        impulses.append(lam)
    return np.array(states), np.array(impulses), cost + 100 * (qu - 1) ** 2


BY_HAND = {"wall-1d": (wall_by_hand, -0.5, 0.3), "push-1d": (push_by_hand, 0.3, 0.5)}


@pytest.mark.parametrize("law", MU)
@pytest.mark.parametrize("name", BY_HAND)
@some
@seeds
def test_open_loop_equals_a_simulation_by_hand(name: str, law: str, seed: int) -> None:
    simulate, mean, spread = BY_HAND[name]
    u = mean + spread * np.random.default_rng(seed).standard_normal(N)
    x, lam, cost = simulate(u, MU[law])
    problem = problem_of(name)
    found = roll_out(problem, u[None, :, None], values_of(problem), step_of(name, law))
    np.testing.assert_allclose(found.x[0], x, atol=1e-9)
    np.testing.assert_allclose(found.lam[0, :, 0], lam, atol=1e-8)
    np.testing.assert_allclose(found.lam * found.gap, MU[law], atol=1e-11)
    assert found.cost == pytest.approx(cost, rel=1e-8)
    assert (lam > 1e-2).any(), "the drawn inputs must make contact, or nothing is tested"


@some
@seeds
def test_feedback_is_clipped_as_an_actuator_would(seed: int) -> None:
    noise = np.random.default_rng(seed)
    gains = Gains(2 * noise.standard_normal((N, 1, 2)), noise.standard_normal((N, 1)))
    problem = problem_of("wall-1d")
    starts = np.array([1.0, 0.0]) + 0.2 * noise.standard_normal((3, 2))
    found = roll_out(problem, gains, values_of(problem), step_of("wall-1d", "exact"), starts)
    for s, (x, v) in enumerate(starts):
        cost = 0.0
        for k in range(N):
            u = min(1.0, max(-1.0, gains.K[k, 0] @ np.array([x, v]) + gains.k[k, 0]))
            assert found.u[s, k, 0] == pytest.approx(u, abs=1e-12)
            cost += (x + 0.5) ** 2 + 0.1 * v**2 + 0.01 * u**2
            v += u + contact(x + 0.1 * (v + u), 0.1, 0.0)
            x += 0.1 * v
            np.testing.assert_allclose(found.x[s, k + 1], (x, v), atol=1e-9)
        assert found.costs[s] == pytest.approx(cost + 10 * (x + 0.5) ** 2, rel=1e-8)
    assert found.cost == pytest.approx(found.costs.mean())


def test_one_stationary_gain_serves_every_step() -> None:
    gains = Gains(np.array([[[0.1, -0.2]]]), np.array([[0.3]]))
    problem = problem_of("wall-1d")
    found = roll_out(problem, gains, values_of(problem))
    expected = found.x[0, :-1] @ np.array([0.1, -0.2]) + 0.3
    np.testing.assert_allclose(found.u[0, :, 0], expected, atol=1e-12)


@some
@seeds
def test_costs_on_increments_start_from_the_input_before(seed: int) -> None:
    """The cost of push-disc is the sum of 0.01 |o - goal|² + 0.1 |du|², plus 10 |o_N - goal|²."""
    noise = np.random.default_rng(seed)
    problem = problem_of("push-disc")
    x, u = noise.standard_normal((2, N + 1, 4)), noise.standard_normal((2, N, 2))
    evaluation = Evaluation(problem, problem.parameters.defaults)
    found = evaluation.trajectory_costs(x, u, np.zeros((2, N, 1)))
    off = ((x[..., :2] - [1.0, 0.5]) ** 2).sum(axis=-1)
    before = np.concatenate([np.tile([-1.0, 0.2], (2, 1, 1)), u[:, :-1]], axis=1)
    stage = 0.01 * off[:, :-1] + 0.1 * ((u - before) ** 2).sum(axis=-1)
    np.testing.assert_allclose(found, stage.sum(axis=1) + 10 * off[:, -1], rtol=1e-12)


@some
@seeds
def test_a_scenario_alone_has_the_bits_it_has_among_others(seed: int) -> None:
    """This also holds next to a scenario whose inputs become NaN."""
    noise = np.random.default_rng(seed)
    problem = problem_of("push-disc")
    u = noise.standard_normal((4, N, 2))
    u[2, 5:] = np.nan
    x0 = np.tile(problem.initial_states(problem.parameters.pack(values_of(problem))), (4, 1))
    x0[:, :2] += 0.1 * noise.standard_normal((4, 2))
    together, unsolved = roll_on(Evaluation(problem, values_of(problem)), u, x0=x0)
    assert unsolved is not None
    assert (unsolved.scenario, unsolved.step) == (2, 5)
    for s in range(4):
        alone, _ = roll_on(Evaluation(problem, values_of(problem)), u[[s]], x0=x0[[s]])
        for name in ("x", "lam", "gap", "costs"):
            np.testing.assert_array_equal(getattr(together, name)[[s]], getattr(alone, name))
