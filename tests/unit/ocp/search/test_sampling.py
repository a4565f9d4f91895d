"""Sampled plans: bases of knots, costs compared with other routes, penalties for constraints, reproducibility."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.stats import truncnorm

from dynamics.contact import Exact
from ocp import solve
from ocp.errors import InputError
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import roll_out
from ocp.search import sampling
from ocp.search.sampling import FEW_ROUNDS, MANY_ROUNDS, MIN_SAMPLES, STAGES, InputSampler
from ocp.search.sampling_runs import ELITE_SHARE, AdaptedRun, CrossEntropyRun, Narrowing, SamplingRun, input_basis
from problems import get


@pytest.fixture(autouse=True)
def few_runs(monkeypatch):
    """Limit the sampler to two bases and forty rounds, which suffice for few inputs."""
    monkeypatch.setattr(sampling, "KNOTS", (4, 8))
    monkeypatch.setattr(sampling, "MIN_ADAPTED_ROUNDS", 40)
    monkeypatch.setattr(sampling, "MAX_ADAPTED_ROUNDS", 40)
    monkeypatch.setattr(sampling, "FEW_ROUNDS", Narrowing(20, 0.2))
    monkeypatch.setattr(sampling, "MANY_ROUNDS", Narrowing(60, 0.6))


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


def run_of(method: type[SamplingRun], narrowing: Narrowing, mean: np.ndarray, seed: int) -> SamplingRun:
    """Return a run whose inputs (K, 1) are its samples, from a normal distribution of deviation 1."""
    K, generator = len(mean), np.random.default_rng(seed)
    return method(Exact(), np.eye(K), mean, np.ones((K, 1)), generator, narrowing, "run")


@pytest.mark.parametrize("narrowing", [FEW_ROUNDS, MANY_ROUNDS], ids=["few rounds", "many rounds"])
def test_a_round_moves_the_distribution_to_the_tail_of_the_normal_one(narrowing: Narrowing) -> None:
    run = run_of(CrossEntropyRun, replace(narrowing, samples=200_000), np.zeros((2, 1)), seed=0)
    run.advance(lambda inputs, _: inputs[:, 0, 0], rounds=1)
    tail = truncnorm(-np.inf, truncnorm(-np.inf, np.inf).ppf(ELITE_SHARE))
    weight = 1 - narrowing.smoothing
    np.testing.assert_allclose(run.mean[:, 0], [weight * tail.mean(), 0.0], atol=0.02)
    np.testing.assert_allclose(run.deviation[:, 0], [narrowing.smoothing + weight * tail.std(), 1.0], atol=0.02)


@pytest.mark.parametrize("condition", [1e2, 1e4])
def test_adapted_covariance_follows_a_valley_of_correlated_inputs(condition: float) -> None:
    """A quadratic along turned axes is minimised to 1e-8; the cross-entropy method narrows before it arrives."""
    axes = np.linalg.qr(np.random.default_rng(1).standard_normal((6, 6)))[0]
    curvatures = np.geomspace(1, condition, 6)

    def costs(inputs: np.ndarray, progress: float) -> np.ndarray:
        return ((inputs[:, :, 0] - 0.5) @ axes) ** 2 @ curvatures

    methods = ((AdaptedRun, Narrowing(300, samples=40)), (CrossEntropyRun, Narrowing(120, 0.6, samples=100)))
    runs = [run_of(method, narrowing, np.zeros((6, 1)), seed=4) for method, narrowing in methods]
    for run in runs:
        run.advance(costs, run.narrowing.rounds)
        assert run.best_cost == pytest.approx(costs(run.inputs(run.best)[None], 1.0)[0])
    adapted, fitted = runs
    assert adapted.best_cost < 1e-8 < fitted.best_cost
    np.testing.assert_allclose(adapted.best, 0.5, atol=1e-4)


def test_a_budget_buys_many_rounds_as_soon_as_they_have_enough_samples() -> None:
    at_values = evaluation(wall())
    budgets = range(40_000, 1_000_000, 39_946)
    samplers = [InputSampler(at_values, laws=(Exact(),), rollout_steps=budget) for budget in budgets]
    rounds = [sampler.narrowing.rounds for sampler in samplers]
    assert rounds == sorted(rounds) and len(set(rounds)) == 2
    assert all(sampler.narrowing.samples >= MIN_SAMPLES for sampler in samplers)
    for sampler, budget in zip(samplers, budgets, strict=True):
        runs = [run for run in sampler.runs if isinstance(run, CrossEntropyRun)]
        steps = 10 * sampler.narrowing.samples * 2 * len(runs) * sampler.narrowing.rounds / STAGES
        assert steps <= budget / 2 or sampler.narrowing.samples == MIN_SAMPLES
        assert steps > 0.97 * budget / 2


@pytest.mark.parametrize("most", [120, 300, 600])
def test_samples_of_a_run_are_limited_unless_the_number_of_steps_is_stated(most: int) -> None:
    few, many = sampling.FEW_ROUNDS.rounds, sampling.MANY_ROUNDS.rounds
    limited, stated = (
        InputSampler(evaluation(wall()), laws=(Exact(),), rollout_steps=steps, max_samples=most)
        for steps in (None, 20_000_000)
    )
    assert most * few - many < limited.narrowing.samples * limited.narrowing.rounds <= most * few
    assert stated.narrowing.samples * stated.narrowing.rounds > 600 * few


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
    limited = replace(problem, x_lower=ca.DM([-np.inf, -limit]), x_upper=ca.DM([np.inf, limit]))
    # Plans of other laws keep the limit under these laws, and may exceed it in an exact replay.
    sampler, unlimited = (InputSampler(evaluation(posed), laws=(Exact(),)) for posed in (limited, problem))
    for plan in list(sampler.stages())[-1]:
        assert np.all(plan.inputs >= sampler.lower) and np.all(plan.inputs <= sampler.upper)
        assert fastest(problem, plan.inputs) < 1.001 * limit
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
