"""Policies fitted to plans: the fit recovers a linear regulator, and learning starts from it."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from dynamics.batch import dense_policy
from dynamics.contact import Exact
from dynamics.systems import Parameter, ParameterTable, Signal, lcs
from ocp import Solution, solve
from ocp.errors import InputError
from ocp.learning.experiment import EXACT, Experiment
from ocp.learning.imitation import demonstrations, fit_actions, squared_error, tracking_gains
from ocp.learning.mbpo import MBPO
from ocp.learning.planned import planned_problem
from ocp.learning.protocol import TrainedPolicy, first_weights
from ocp.learning.training import evaluate, train
from ocp.learning.unroll_gradients import FOPG
from ocp.problem.problem import Scaling
from ocp.problem.task import Task

H = 0.1
A, B = np.array([[1.0, H], [0.0, 1.0]]), np.array([[0.0], [H]])
Q, R = np.diag([2.0, 1.0]), np.array([[0.5]])
P = solve_discrete_are(A, B, Q, R)
GAIN = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
"""Gain of the regulator u = -GAIN x, which is optimal at every horizon with the terminal cost x' P x."""


def regulated(horizon: int = 8, largest: float = 1e3) -> Task:
    """Return a task of bringing a mass to rest at 0, with a contact far away."""
    p = ParameterTable([Parameter("unit", 1.0, "1")])
    system = lcs(
        "mass",
        A=A,
        B=B,
        C=[[0.0], [H]],
        D=[[1.0, 0.0]],
        E=[[0.0]],
        F=[[1.0]],
        d=[1e3],
        parameters=p,
    )
    chance, x, u = ca.SX.sym("chance", 2), system.x, system.u
    return Task(
        name="mass",
        system=system,
        parameters=p,
        horizon=horizon,
        start=chance,
        chance=chance,
        reward=-ca.bilin(ca.DM(Q), x, x) - ca.bilin(ca.DM(R), u, u),
        final=-ca.bilin(ca.DM(P), x, x),
        observation=x,
        observations=(Signal("x", "m"), Signal("v", "m/s")),
        lower=np.array([-largest]),
        upper=np.array([largest]),
    )


def plans(task: Task, n: int = 4) -> list[Solution]:
    """Return optimal plans from ``n`` random starts."""
    starts = task.reset(n, np.random.default_rng(2))
    return [solve(planned_problem(task, x0), Exact()) for x0 in starts]


@pytest.fixture(scope="module")
def found() -> list[Solution]:
    return plans(regulated())


@pytest.mark.costly
def test_the_affine_policy_is_the_regulator(found: list[Solution]):
    task = regulated()
    policy = fit_actions(task, *demonstrations(found))
    W, b = policy.theta[:2], policy.theta[2]
    slope = task.upper[0] * W / policy.normaliser.scale
    np.testing.assert_allclose(slope, -GAIN[0], rtol=1e-5)
    offset = task.upper[0] * b - slope @ policy.normaliser.mean
    assert offset == pytest.approx(0.0, abs=1e-5)


@pytest.mark.costly
def test_gains_along_a_plan_are_those_of_the_riccati_recursion():
    task = regulated(horizon=150)
    scaling = Scaling(x=0.5, u=2.0)
    problem = planned_problem(task, np.array([1.0, -0.5]), scaling=scaling)
    plan = solve(problem, Exact())
    gains = tracking_gains(plan)
    weights = np.eye(2) / 0.5**2, np.eye(1) / 2.0**2
    S = solve_discrete_are(A, B, *weights)
    stationary = np.linalg.solve(weights[1] + B.T @ S @ B, B.T @ S @ A)
    np.testing.assert_allclose(gains.K[0], -stationary, rtol=1e-6)
    last = np.linalg.solve(weights[1] + B.T @ weights[0] @ B, B.T @ weights[0] @ A)
    np.testing.assert_allclose(gains.K[-1], -last, rtol=1e-7, atol=1e-8)
    x, u = plan.data["x"].values[0], plan.data["u"].values[0]
    for k in (0, 7, 149):
        np.testing.assert_allclose(gains.input(k, x[k]), u[k], rtol=1e-9)


@pytest.mark.costly
def test_beside_a_plan_its_feedback_says_what_to_do(found: list[Solution]):
    states, inputs = demonstrations(found[:1], copies=3, spread=0.2, seed=4)
    plan = found[0]
    x, u = plan.data["x"].values[0], plan.data["u"].values[0]
    np.testing.assert_array_equal(states[:8], x[:-1])
    np.testing.assert_array_equal(inputs[:8], u)
    gains = tracking_gains(plan)
    off = states[8:].reshape(8, 3, 2) - x[:-1, None]
    expected = u[:, None] + np.einsum("kij,kcj->kci", gains.K, off)
    np.testing.assert_allclose(inputs[8:].reshape(8, 3, 1), expected, rtol=1e-9, atol=1e-9)
    assert off.std() == pytest.approx(0.2, rel=0.3)
    again = demonstrations(found[:1], copies=3, spread=0.2, seed=4)
    np.testing.assert_array_equal(states, again[0])


def test_the_slope_of_the_error_is_that_of_differences():
    task = regulated()
    policy = dense_policy(task.observe, (4, 3), task.lower, task.upper)
    rng = np.random.default_rng(0)
    seen, wanted = rng.normal(size=(150, 2)), rng.normal(size=(150, 1))
    theta = first_weights(policy.sizes, 1.0, rng)
    error, slope = squared_error(theta, policy, seen, wanted)
    actions = policy.mean_actions(theta, seen)
    assert error == pytest.approx(np.mean((actions - wanted) ** 2), rel=1e-12)
    for i, direction in enumerate(np.eye(theta.size)):
        ends = [squared_error(theta + s * 1e-6 * direction, policy, seen, wanted)[0] for s in (1, -1)]
        assert slope[i] == pytest.approx((ends[0] - ends[1]) / 2e-6, abs=1e-7)


@pytest.mark.costly
def test_a_network_does_what_plans_with_bounds_do():
    task = regulated(largest=0.4)
    shown = plans(task, 6)
    policy = fit_actions(task, *demonstrations(shown), (16, 16), seed=1)
    experiment = Experiment(task=task, algorithm=FOPG(), hidden=(16, 16), threads=1)
    states, inputs = demonstrations(shown)
    assert np.abs(inputs).max() > 0.399
    done = experiment.inputs(policy, states)
    assert np.abs(done - inputs).max() < 0.02
    again = fit_actions(task, *demonstrations(shown), (16, 16), seed=1)
    np.testing.assert_array_equal(policy.theta, again.theta)
    other = fit_actions(task, *demonstrations(shown), (16, 16), seed=2)
    assert np.abs(policy.theta - other.theta).max() > 0.1


@pytest.mark.costly
def test_learning_begins_at_the_fitted_policy(found: list[Solution]):
    task = regulated()
    policy = fit_actions(task, *demonstrations(found))
    algorithm = FOPG(samples=4, unroll=4, rate=1e-6)
    given = {"task": task, "algorithm": algorithm, "law": Exact(), "iterations": 1, "threads": 1}
    experiment = Experiment(**given, start=policy)
    state = algorithm.begin(experiment)
    np.testing.assert_array_equal(state["theta"], policy.theta)
    np.testing.assert_array_equal(state["normaliser.mean"], policy.normaliser.mean)
    first = train(experiment)["evaluation_return"].values[0]
    blank = Experiment(**given)
    assert first == evaluate(blank, policy, EXACT, blank.episodes).returns.mean()
    # The optimum from x is -x' P x, and the plans' policy is the optimal one.
    starts = task.reset(blank.episodes, np.random.default_rng(1_000_000))
    optimum = -np.einsum("ni,ij,nj->n", starts, P, starts).mean()
    assert first == pytest.approx(optimum, rel=1e-6)
    assert train(blank)["evaluation_return"].values[0] < optimum - 0.1


@pytest.mark.costly
def test_a_start_is_told_by_its_content(found: list[Solution]):
    task = regulated()
    policy = fit_actions(task, *demonstrations(found))
    moved = TrainedPolicy(policy.theta + 1e-12, policy.normaliser)
    given = {"task": task, "algorithm": FOPG(), "threads": 1}
    told = [Experiment(**given, start=one).settings()["start"] for one in (policy, moved)]
    assert told[0] == policy.digest != told[1]
    assert Experiment(**given).settings()["start"] is None


def test_what_cannot_be_started_from_is_named(found: list[Solution]):
    task = regulated()
    policy = fit_actions(task, *demonstrations(found))
    with pytest.raises(InputError, match="the same task and layers"):
        Experiment(task=task, algorithm=FOPG(), hidden=(3,), start=policy)
    mbpo = Experiment(task=task, algorithm=MBPO(), start=policy)
    with pytest.raises(InputError, match="leave start out"):
        mbpo.algorithm.begin(mbpo)
    with pytest.raises(InputError, match="no plans to fit"):
        fit_actions(task, *demonstrations([]))
