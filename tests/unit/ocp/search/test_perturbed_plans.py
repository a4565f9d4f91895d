"""Plans sampled near an answer, each improved from another random change of its inputs."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import roll_out
from ocp.search.perturbed_plans import MAX_PLANS, MIN_PLANS, perturbed_plans
from ocp.search.sampling import InputSampler
from ocp.search.sampling_runs import SampledPlan
from problems import get

VALLEYS = (1.5, 3.0)
"""Positions [m] of the two minima of the terminal cost."""
TILT = 0.05
"""Cost per metre by which the nearer minimum costs more."""


def two_valleys(N: int = 10) -> Problem:
    """Return a mass that starts at 1 m, whose terminal cost ((x - 1.5) (x - 3))^2 + 0.05 (3 - x) has two minima."""
    problem = get("wall-1d", N=N)
    x = problem.system.x[0]
    terminal_cost = ((x - VALLEYS[0]) * (x - VALLEYS[1])) ** 2 + TILT * (VALLEYS[1] - x)
    return replace(problem, stage_cost=ca.SX(0), terminal_cost=terminal_cost)


def plans_near(problem: Problem, inputs: np.ndarray, seed: int = 0) -> list[SampledPlan]:
    sampler = InputSampler(Evaluation(problem, problem.parameters.defaults), seed=0)
    return perturbed_plans(sampler, inputs, np.random.default_rng(seed))


def last_position(problem: Problem, inputs: np.ndarray) -> float:
    return float(roll_out(problem, inputs[None], problem.parameters.defaults).x[0, -1, 0])


def test_changed_plans_reach_the_better_of_two_minima_and_the_nearer_one() -> None:
    problem = two_valleys()
    # Constant inputs u move the mass by h sum_{k=1..N} k u = 5.5 u.
    inputs = np.full((problem.N, 1), (VALLEYS[0] - 1.0) / 5.5)
    assert last_position(problem, inputs) == pytest.approx(VALLEYS[0])
    plans = plans_near(problem, inputs)
    assert MIN_PLANS <= len(plans) <= MAX_PLANS
    assert [plan.cost for plan in plans] == sorted(plan.cost for plan in plans)
    ends = [last_position(problem, plan.inputs) for plan in plans]
    assert ends[0] == pytest.approx(VALLEYS[1], abs=0.1)
    assert min(ends) == pytest.approx(VALLEYS[0], abs=0.1)


def test_costs_are_those_of_exact_rollouts_and_inputs_keep_their_bounds() -> None:
    problem = get("wall-1d", N=10)
    for plan in plans_near(problem, np.full((10, 1), -0.8)):
        assert np.abs(plan.inputs).max() <= 1.0
        exact = roll_out(problem, plan.inputs[None], problem.parameters.defaults).cost
        assert exact == pytest.approx(plan.cost, rel=1e-9)


def test_a_generator_determines_every_bit_and_another_draws_others() -> None:
    problem, inputs = two_valleys(), np.zeros((10, 1))
    first, again, other = (plans_near(problem, inputs, seed) for seed in (1, 1, 2))
    assert all(np.array_equal(a.inputs, b.inputs) for a, b in zip(first, again, strict=True))
    assert not all(np.array_equal(a.inputs, b.inputs) for a, b in zip(first, other, strict=True))
