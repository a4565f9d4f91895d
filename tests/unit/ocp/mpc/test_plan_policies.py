"""Gains along a plan against scipy's, its linear dynamics at an impact against differences."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from ocp import Solution, roll_out, solve
from ocp.mpc.plan_policies import ControllerPolicy, PlanRegulator, Weights
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Rollout, StateFeedback, roll_on
from problems import get

HILL = str(Path(__file__).parents[3] / "golden" / "cases" / "hill.py")


def rolled(solution: Solution) -> tuple[Evaluation, Rollout]:
    evaluation = Evaluation(solution.problem, solution.values)
    arrays = (solution.data[name].values for name in ("x", "u", "lam", "gap"))
    return evaluation, Rollout.from_trajectories(evaluation, solution.problem.exact_step, *arrays)


@pytest.mark.costly
def test_gains_far_from_contact_are_those_of_the_riccati_equation() -> None:
    solution = solve(HILL, "exact", effort="quick", N=80)
    p, h = solution.values, solution.values["h"]
    K = PlanRegulator(*rolled(solution)).gains().K
    step_v = np.array([h * p["a"], 1.0])
    A = np.array([[1 + h * step_v[0], h], step_v])
    B = np.array([[h * h], [h]]) / p["m"]
    Q, R = 2 * h * np.diag([1.0, 0.0]), 2 * h * np.array([[p["w_u"]]])
    P = solve_discrete_are(A, B, Q, R)
    expected = -np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    assert K[0] == pytest.approx(expected, rel=1e-6)
    P_end = np.diag([2 * p["w_end"], 2 * p["w_rest"]])
    assert K[-1] == pytest.approx(-np.linalg.solve(R + B.T @ P_end @ B, B.T @ P_end @ A), rel=1e-7)


@pytest.mark.costly
@pytest.mark.parametrize("name", ["wall-1d", "box-slide"])
def test_steps_of_a_plan_in_contact_have_the_derivatives_of_differences(name: str) -> None:
    """Of steps in which no contact is at the edge of another active set, impacts included."""
    solution = solve(name, "exact", effort="quick")
    evaluation, plan = rolled(solution)
    lin, step = PlanRegulator(evaluation, plan).linearised(), solution.problem.exact_step
    p, scales = evaluation.step_values(step), solution.problem.scales
    active = 0
    for k in range(solution.problem.N):
        x, u, gap, lam = plan.x[0, k], plan.u[0, k], plan.gap[0, k], plan.lam[0, k]
        if np.min(np.maximum(lam / scales.impulse, gap / scales.gap)) < 1e-3:
            continue
        active += bool((lam > 1e-3 * scales.impulse).any())
        numeric = np.empty((len(x), len(x) + len(u)))
        for i, size in enumerate([*scales.x, *scales.u]):
            change = 1e-6 * size * (np.arange(numeric.shape[1]) == i)
            ends = [
                np.ravel(step.solve(x + sign * change[: len(x)], u + sign * change[len(x) :], p)[0]) for sign in (1, -1)
            ]
            numeric[:, i] = (ends[0] - ends[1]) / (2e-6 * size)
        analytic = np.hstack([lin.x_next.by_x[k], lin.x_next.by_u[k]])
        assert analytic == pytest.approx(numeric, abs=1e-5 * max(1, abs(numeric).max()))
    assert active > 0


@pytest.mark.costly
def test_gains_keep_the_trajectory_of_the_plan_whatever_they_track() -> None:
    solution = solve("ball-bounce", "exact", effort="quick")
    evaluation, plan = rolled(solution)
    regulator = PlanRegulator(evaluation, plan)
    gains = [regulator.gains(weights) for weights in (Weights(), Weights(end=100.0), Weights(1.0, 1.0, 1.0))]
    for policy in gains:
        assert isinstance(policy, StateFeedback)
        x = roll_out(solution.problem, policy, solution.values, x0=plan.x[:, 0]).x
        assert x == pytest.approx(plan.x, abs=1e-6)
    assert np.abs(gains[0].K - gains[2].K).max() > 1e-3


def test_the_most_exact_problem_keeps_its_costs_and_is_its_own_most_exact_problem() -> None:
    exact = get("wall-1d")
    assert exact.most_exact is exact
    push = get("planar-push")
    referee_problem = push.most_exact
    assert referee_problem.system is push.system.most_exact and referee_problem.most_exact is referee_problem
    x, u, lam = np.full(push.system.nx, 0.3), np.full(push.system.nu, 0.1), np.zeros(push.system.nlam)
    p = push.parameters.values
    costs = [
        float(problem.cost_terms(x, u, 0 * u, np.zeros(problem.system.nlam), p)[0])
        for problem in (push, referee_problem)
    ]
    assert costs[0] == costs[1] and lam.size != referee_problem.system.nlam
    assert replace(push, N=3).most_exact.N == 3


@pytest.mark.costly
def test_redundant_contacts_are_regulated_by_a_smoothing_of_them() -> None:
    """Eight corners of a cube share its weight: an active set of all has no linearisation."""
    solution = solve("push-cube", "exact", effort="quick", N=2)
    regulator = PlanRegulator(*rolled(solution))
    lin = regulator.linearised()
    assert np.isfinite(lin.x_next.by_x).all() and np.isfinite(regulator.gains(Weights(1.0)).K).all()


@pytest.mark.costly
def test_a_small_smoothing_has_the_derivatives_of_the_active_set() -> None:
    solution = solve("ball-bounce", "exact", effort="quick")
    regulator = PlanRegulator(*rolled(solution))
    exact = regulator.linearised().x_next
    errors = [abs(regulator.linearised(mu).x_next.by_x - exact.by_x).max() for mu in (1e-2, 1e-5, 1e-8)]
    assert errors[0] > errors[1] > errors[2] and errors[2] < 1e-4 * abs(exact.by_x).max()


@pytest.mark.costly
def test_a_controller_begins_anew_at_step_0() -> None:
    solution = solve(HILL, "exact", effort="quick", N=10)
    evaluation, plan = rolled(solution)
    policy = ControllerPolicy(evaluation)
    rollouts = [roll_on(evaluation, policy, x0=plan.x[:, 0])[0] for _ in range(2)]
    assert np.array_equal(rollouts[0].u, rollouts[1].u)
    assert policy.samples == 20 and policy.n_unplanned == 0
    assert rollouts[0].cost < 2 * solution.cost
