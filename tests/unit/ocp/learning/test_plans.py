"""Plans of a task's episode agree with independent searches and closed forms."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import minimize

from dynamics.contact import Exact
from ocp.errors import InputError
from ocp.learning.experiment import Experiment
from ocp.learning.planned import (
    best_plan,
    episode_return,
    guess_from_constant_inputs,
    guess_from_policy,
    planned_problem,
)
from ocp.learning.protocol import Normaliser, TrainedPolicy
from ocp.learning.unroll_gradients import FOPG
from ocp.problem.evaluation import Evaluation
from ocp.problem.task import Task
from problems.library import ball_throw
from problems.tasks import registry
from tests.unit.ocp.learning.scalar import A, B, scalar

START = np.array([0.2])


def returned(task: Task, states: np.ndarray, inputs: np.ndarray, p: np.ndarray | None = None) -> float:
    """Return the sum of all rewards and the final reward, step by step."""
    p = task.parameters.values if p is None else p
    steps = zip(states[:-1], inputs, states[1:], strict=True)
    return sum(float(task.rewards(*at, p)) for at in steps) + float(task.finals(states[-1], p))


def best_inputs(task: Task, cap: float = np.inf) -> float:
    """Return the largest return of the scalar task over inputs, with all states but the last at most ``cap``."""

    def motion(u: np.ndarray) -> np.ndarray:
        x = [START]
        for at in u:
            x.append(A * x[-1] + B * at)
        return np.array(x)

    below = {"type": "ineq", "fun": lambda u: cap - motion(u)[1:-1, 0]}
    found = minimize(
        lambda u: -returned(task, motion(u), u[:, None]),
        np.zeros(task.horizon),
        method="SLSQP",
        bounds=[(-2, 2)] * task.horizon,
        constraints=[below] if np.isfinite(cap) else [],
        options={"ftol": 1e-14},
    )
    return -found.fun


@pytest.mark.costly
def test_the_best_throw_is_that_of_a_search_over_angle_and_speed():
    task = registry.get("ball-throw", goal_x=2.0)
    x0 = task.reset(1, np.random.default_rng(0))[0]
    params = ball_throw.Params()

    def missed(throw: np.ndarray) -> float:
        return -returned(task, ball_throw.roll(params, *throw), np.zeros((task.horizon, 2)))

    options = {"xatol": 1e-10, "fatol": 1e-15, "maxiter": 5000}
    searched = min(
        minimize(missed, (angle, speed), method="Nelder-Mead", options=options).fun
        for angle in (-0.5, 0.3, 0.9)
        for speed in (2.0, 4.0)
    )
    found = best_plan(task, x0, guess_from_constant_inputs(task, 64))
    assert found.certified
    assert found.planned_return == pytest.approx(-searched, rel=1e-8)
    assert found.replayed_return == pytest.approx(-searched, rel=1e-8)
    assert found.lived == task.horizon


def test_the_cost_is_minus_the_return_whatever_the_trajectory():
    task = scalar(horizon=4)
    x, u, after = task.system.x, task.system.u, task.system.x_next
    goal = task.parameters["goal"]
    mixed = replace(task, reward=goal * after**3 + 0.5 * (ca.cos(after) + x * u) - ca.exp(x), final=x**2)
    problem = planned_problem(mixed, START)
    rng, none = np.random.default_rng(5), np.zeros((1, 4, task.system.nlam))
    for p in (np.array([1.0]), np.array([-2.0])):
        states = np.vstack([START, rng.normal(size=(4, 1))])
        inputs = rng.normal(size=(4, 1))
        cost = Evaluation(problem, {"goal": p[0]}).trajectory_costs(states[None], inputs[None], none)[0]
        assert cost == pytest.approx(-returned(mixed, states, inputs, p), rel=1e-12)


def straight_line_guess(first, last):
    """Return a guess on the straight line between two states, with inputs in the middle of their bounds."""

    def guess(problem, p):
        low, high = (np.array(end).ravel() for end in problem.limits(p)[2:4])
        states = np.linspace(first, last, problem.N + 1)
        states[0] = problem.initial_states(p)[0]
        return states, np.tile((low + high) / 2, (problem.N, 1))

    return guess


@pytest.mark.parametrize("guess", [[], [straight_line_guess(START, np.array([1.0]))]])
def test_a_plan_without_contact_is_the_optimum(guess: list):
    task = scalar(horizon=5)
    found = best_plan(task, START, *guess)
    assert found.certified
    assert found.planned_return == pytest.approx(best_inputs(task), rel=1e-7)
    assert "best plan found" in found.description
    assert "bound" not in found.description


def test_an_episode_goes_on_until_its_last_state():
    cap = 0.6
    free = scalar(horizon=3)
    task = replace(free, done=free.system.x > cap, lasts=cap - free.system.x)
    found = best_plan(task, START)
    states = found.solution.data["x"].values[0, :, 0]
    assert states[:-1].max() == pytest.approx(cap, abs=1e-5)
    assert states[-1] > cap
    assert found.lived == 3
    assert found.planned_return == pytest.approx(best_inputs(free, cap), rel=1e-4)
    assert found.planned_return < best_inputs(free) - 1e-3


def test_where_something_is_gained_at_the_end_the_last_state_counts_too():
    task = scalar(horizon=3)
    task = replace(task, final=0.1 * task.system.x, done=task.system.x > 0.6, lasts=0.6 - task.system.x)
    found = best_plan(task, START)
    assert found.solution.data["x"].values.max() <= 0.6
    assert found.planned_return == pytest.approx(found.replayed_return, abs=1e-8)


def test_a_plan_that_was_cut_short_is_called_no_optimum():
    found = best_plan(scalar(horizon=5), START, settings={"max_iter": 1})
    assert not found.certified
    assert "not certified" in found.description


def test_a_policy_is_where_a_search_begins():
    task = scalar(horizon=4)
    experiment = Experiment(task=task, algorithm=FOPG(), law=Exact(), threads=1)
    policy = TrainedPolicy(np.array([0.3, 0.1]), Normaliser(4.0, np.array([0.5]), np.array([1.0])))
    problem = planned_problem(task, START)
    states, inputs = guess_from_policy(experiment, policy)(problem, problem.parameters.values)
    x = START
    for k in range(4):
        u = 2 * np.tanh(0.3 * (x - 0.5) / 0.5 + 0.1)
        np.testing.assert_allclose(inputs[k], u, rtol=1e-12)
        np.testing.assert_allclose(states[k], x, rtol=1e-9)
        x = A * x + B * u
    better = best_plan(task, START, guess_from_policy(experiment, policy))
    assert better.planned_return > returned(task, states, inputs) + 1e-3
    assert better.planned_return == pytest.approx(best_inputs(task), rel=1e-7)


@pytest.mark.costly
def test_the_better_one_of_two_guesses_counts():
    task = registry.get("ball-throw", goal_x=2.0)
    x0 = task.reset(1, np.random.default_rng(0))[0]

    def thrown(angle: float, speed: float):
        inputs = np.zeros((task.horizon, 2))
        inputs[0] = angle, speed
        states = ball_throw.roll(ball_throw.Params(), angle, speed)
        return lambda problem, p: (states, inputs)

    worse, better = thrown(-1.2, 8.0), thrown(0.7, 2.6)
    alone = best_plan(task, x0, worse)
    both = best_plan(task, x0, worse, better)
    assert both.planned_return > alone.planned_return + 1e-3
    assert [attempt.chosen for attempt in both.solution.route.attempts] == [False, True]


def test_an_episode_counts_until_its_end_and_no_further_than_it_was_solved():
    task = scalar(horizon=3, done=2.0)
    task = replace(task, final=10.0, reward=task.system.x)
    inputs = np.zeros((3, 1))
    for states, expected, lived in (
        ([0.5, 1.0, 1.5, 1.0], 13.0, 3),
        ([0.5, 1.0, 2.5, 1.0], 1.5, 2),
        ([0.5, 1.0, 1.5, 2.5], 3.0, 3),
        ([0.5, 1.0, np.nan, np.nan], 0.5, 1),
        ([2.5, 1.0, 1.0, 1.0], 0.0, 0),
    ):
        found = episode_return(task, np.array(states)[:, None], inputs)
        assert found == (pytest.approx(expected), lived)


def test_what_cannot_be_planned_is_named():
    task = scalar()
    product = replace(task, reward=task.system.x_next * task.system.u)
    with pytest.raises(InputError, match=r"term in x_next also depends on u\b"):
        planned_problem(product, START)
    with pytest.raises(InputError, match=r"give Task\.lasts"):
        planned_problem(scalar(done=0.8), START)
    with pytest.raises(InputError, match="ends before its first step"):
        planned_problem(replace(scalar(done=0.1), lasts=ca.SX(0, 1)), START)
    for wrong in (np.zeros(2), np.array([np.nan])):
        with pytest.raises(InputError, match="starts at 1 finite numbers"):
            planned_problem(task, wrong)
