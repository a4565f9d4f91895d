"""Gains that are improved along their motions in MuJoCo, against closed forms and a Riccati recursion."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.systems import Link, Machine, Parameter, ParameterTable
from ocp import Constraint, InputError, Problem, Scaling, solve
from ocp.judge.referee import STATE_SHARE
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Gains, roll_out
from ocp.simulators.mujoco_world import STEP_S, MujocoWorld
from ocp.simulators.replay import simulated_costs
from ocp.solve.simulator_gains import SimulatorOutcomes, gains_in_simulator, with_gains_in

H, N, MASS = 0.02, 10, 2.0
CART = Machine((Link("cart", None, MASS, 1.0, joint="slide", axis=(1.0, 0.0), gear=1.0),), ())


def cart() -> Problem:
    """Return the problem of bringing a cart to rest, with a cost on its states and its force."""
    p = ParameterTable([Parameter("h", H, "s")])
    system = CART.system("cart", p, h=p["h"], friction=None)
    x = system.x
    return Problem(
        "cart", system, N, 0.1 * ca.sumsqr(system.u) + ca.sumsqr(x), 50 * ca.sumsqr(x), ca.SX([1.0, -2.0]), p
    )


def linear_dynamics() -> tuple[np.ndarray, np.ndarray]:
    """Return A, B of semi-implicit Euler steps of MuJoCo over a step of the problem."""
    n = round(H / STEP_S)
    lift = STEP_S**2 * n * (n + 1) / 2
    return np.array([[1.0, H], [0.0, 1.0]]), np.array([[lift], [H]]) / MASS


def outcomes_of(problem: Problem) -> SimulatorOutcomes:
    values = problem.parameters.defaults
    evaluation = Evaluation(problem, values)
    plan = roll_out(problem, np.zeros((1, N, 1)), values)
    return SimulatorOutcomes(evaluation, plan, MujocoWorld(problem, values))


def test_dynamics_by_differences_are_those_of_simulated_steps() -> None:
    outcomes = outcomes_of(cart())
    gains = Gains(np.full((N, 1, 2), -0.3), np.full((N, 1), 0.1))
    (expansion,) = outcomes.expansions(gains)
    A, B = linear_dynamics()
    assert np.allclose(expansion.dynamics, np.hstack([A, B]), atol=1e-9)
    assert np.allclose(expansion.u[:, 0], -0.3 * expansion.x[:-1].sum(axis=1) + 0.1)
    assert np.allclose(expansion.end_gradient, 100 * expansion.x[-1])


def test_passes_end_at_the_optimum_of_a_linear_quadratic_problem() -> None:
    problem = cart()
    outcomes = outcomes_of(problem)
    gains = gains_in_simulator(outcomes.evaluation, outcomes.plan, outcomes.simulator)
    cost = float(simulated_costs(outcomes.simulator, outcomes.evaluation, gains, outcomes.plan.x[:, 0])[0])
    (A, B), V, x = linear_dynamics(), 50 * np.eye(2), np.array([1.0, -2.0])
    for _ in range(N):
        K = np.linalg.solve(0.1 + B.T @ V @ B, B.T @ V @ A)
        V = np.eye(2) + A.T @ V @ (A - B @ K)
    assert cost == pytest.approx(x @ V @ x, rel=1e-4)
    assert cost >= x @ V @ x * (1 - 1e-9)
    assert outcomes.merit(gains) == (0, 0, 0, pytest.approx(cost))


def test_gains_meet_a_constraint_at_the_end_that_a_heavier_cart_misses() -> None:
    """From rest the cart must end at 1; half as heavy again, it reaches less than 2/3 by the plan's forces."""
    p = ParameterTable([Parameter("h", H, "s"), Parameter("mass", MASS, "kg")])
    cart = Machine((Link("cart", None, p["mass"], 1.0, joint="slide", axis=(1.0, 0.0), gear=1.0),), ())
    system = cart.system("cart", p, h=p["h"], friction=None)
    there = Constraint("there", system.x[0], 1.0, 1.0)
    cost = 1e-4 * ca.sumsqr(system.u)
    problem = Problem(
        "cart", system, N, cost, ca.SX(0.0), ca.SX([0.0, 0.0]), p, terminal=(there,), scaling=Scaling(x=1.0, u=100.0)
    )
    values = problem.parameters.defaults
    evaluation = Evaluation(problem, values)
    plan = roll_out(problem, solve(problem).arrays["u"], values)
    assert plan.x[0, -1, 0] == pytest.approx(1.0, abs=1e-6)
    outcomes = SimulatorOutcomes(evaluation, plan, MujocoWorld(problem, values | {"mass": 1.5 * MASS}))
    violated, excess, *_ = outcomes.merit(plan.u)
    (A, B), state = linear_dynamics(), np.zeros(2)
    for force in plan.u[0]:
        state = A @ state + B @ force / 1.5
    assert violated == 1
    assert excess == pytest.approx(1 - state[0] - STATE_SHARE, abs=1e-6)
    gains = gains_in_simulator(evaluation, plan, outcomes.simulator)
    assert outcomes.merit(gains)[:2] == (0, 0)


@pytest.mark.slow
def test_gains_hold_a_plan_in_the_simulator_that_others_do_not() -> None:
    solution = solve("finger-disc", "exact", effort="quick")
    improved = with_gains_in(solution)
    assert solution.replay_in().cost > 5 * solution.cost
    assert solution.cost < improved.replay_in().cost < 1.25 * solution.cost
    with pytest.raises(InputError, match="gains follow a single plan"):
        with_gains_in(improved)
