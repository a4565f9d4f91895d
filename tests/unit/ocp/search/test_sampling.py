"""Sampled plans: bases of knots, costs compared with other routes, penalties for constraints, reproducibility."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from ocp import solve
from ocp.errors import InputError
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import roll_out
from ocp.search import sampling
from ocp.search.sampling import InputSampler, input_basis
from problems import get


@pytest.fixture(autouse=True)
def few_runs(monkeypatch):
    """Limit the sampler to two bases and twenty rounds, which suffice for few inputs."""
    monkeypatch.setattr(sampling, "KNOTS", (4, 8))
    monkeypatch.setattr(sampling, "ROUNDS", 20)


def evaluation(problem: Problem) -> Evaluation:
    return Evaluation(problem, problem.parameters.defaults)


def wall(**changes) -> Problem:
    return replace(get("wall-1d", N=10), **changes)


@pytest.mark.parametrize("basis", ["linear", "constant"])
@pytest.mark.parametrize(("N", "knots"), [(40, 5), (7, 7), (3, 8), (10, 1)])
def test_a_basis_interpolates_and_reproduces_constants(basis, N, knots) -> None:
    weights = input_basis(basis, N, knots)
    assert weights.shape == (N, knots)
    assert np.all(weights >= 0)
    if knots > 1:
        np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    if basis == "linear" and knots > 1:
        line = weights @ np.linspace(0, 1, knots)
        np.testing.assert_allclose(line, np.linspace(0, 1, N), atol=1e-12)


@pytest.mark.costly
def test_sampled_costs_are_those_of_exact_rollouts_and_bound_the_optimum_from_above() -> None:
    problem = wall()
    optimum = solve(problem, contact="exact").cost
    sampler = InputSampler(evaluation(problem), seed=3)
    *_, plans = sampler.stages()
    assert len(plans) == len(sampler.runs)
    for plan in plans:
        exact = roll_out(problem, plan.inputs[None], problem.parameters.defaults).cost
        assert exact == pytest.approx(sampler.exact_cost(plan.inputs), rel=1e-9)
        assert exact > optimum * (1 - 1e-6)
        if plan.run.startswith("exact"):
            assert plan.cost == pytest.approx(exact, rel=1e-9)
    assert min(plan.cost for plan in plans) < 1.1 * optimum


def test_a_seed_determines_every_bit_and_another_draws_others() -> None:
    first, again, other = (
        [plan.inputs for plan in list(InputSampler(evaluation(wall()), seed).stages())[-1]] for seed in (1, 1, 2)
    )
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not all(np.array_equal(a, b) for a, b in zip(first, other, strict=True))


@pytest.mark.costly
def test_inputs_keep_their_bounds_and_states_theirs_by_a_penalty() -> None:
    problem = wall()
    speed = np.abs(solve(problem, contact="exact").data["x"].values[0, :, 1]).max()
    limit = 0.6 * speed
    sampler = InputSampler(
        evaluation(replace(problem, x_lower=ca.DM([-np.inf, -limit]), x_upper=ca.DM([np.inf, limit])))
    )
    unlimited = InputSampler(evaluation(problem))
    for plan in list(sampler.stages())[-1]:
        assert np.all(plan.inputs >= sampler.lower) and np.all(plan.inputs <= sampler.upper)
        assert fastest(problem, plan.inputs) < 1.02 * limit
    assert max(fastest(problem, plan.inputs) for plan in list(unlimited.stages())[-1]) > 1.2 * limit


def fastest(problem: Problem, inputs: np.ndarray) -> float:
    """Return the largest speed of the rollout of inputs (N, nu)."""
    return np.abs(roll_out(problem, inputs[None], problem.parameters.defaults).x[0, :, 1]).max()


def test_search_samples_where_inputs_are_forces() -> None:
    solution = solve(wall(), contact="exact", search=True)
    assert solution.certificate.certified
    assert solution.route.search is not None
    assert solution.route.search.plans
    assert solution.cost <= solve(wall(), contact="exact", search=False).cost * (1 + 1e-6)


def test_no_search_from_several_starts_at_once() -> None:
    with pytest.raises(InputError, match="one scenario"):
        solve(get("push-disc", scenarios=8), contact="exact", search=True)


def test_a_run_around_an_answer_only_improves_it() -> None:
    problem = wall()
    sampler = InputSampler(evaluation(problem), seed=2)
    plan = solve(problem, contact="exact", effort="quick").data["u"].values[0] + 0.3
    around = sampler.around(plan, 20)
    assert around.cost < 0.9 * sampler.exact_cost(plan)
    again = InputSampler(evaluation(problem), seed=2).around(plan, 20)
    np.testing.assert_array_equal(around.inputs, again.inputs)
