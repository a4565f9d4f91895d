"""Searches near an answer: which cost counts, and that they leave the nearer of two minima."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ocp import solve
from ocp.problem.evaluation import Evaluation
from ocp.problem.parts import Constraint
from ocp.problem.problem import Problem
from ocp.problem.rollout import roll_out
from ocp.search.penalties import FREE_SHARE, PENALTY_WEIGHT
from ocp.search.sample_search import NearSearch, SampleSearch
from ocp.search.sampling import InputSampler
from ocp.search.search import OTHER_ROUTES, SAMPLED
from ocp.solve.judging import judge_outcome
from ocp.solve.solve import new_session
from problems import get
from tests.unit.ocp.search.test_perturbed_plans import TILT, VALLEYS, two_valleys


def sampler_of(problem: Problem) -> InputSampler:
    return InputSampler(Evaluation(problem, problem.parameters.defaults))


@pytest.mark.cheap_cases("barrier contacts")
@pytest.mark.parametrize("route", OTHER_ROUTES)
def test_the_better_of_two_minima_is_found_near_the_other_one(route: str) -> None:
    """Its cost is the least root's of the derivative, a cubic polynomial of the last position."""
    problem = two_valleys()
    start, end = 1.0, VALLEYS[0]
    inputs = np.full((problem.N, 1), (end - start) / 5.5)
    guess = roll_out(problem, inputs[None], problem.parameters.defaults)
    answer = solve(problem, contact="exact", effort="quick", guess=(guess.x[0], inputs))
    assert answer.arrays["x"][0, -1, 0] == pytest.approx(end, abs=0.1)
    search = NearSearch(new_session(problem, "exact"), judge_outcome)
    assert not search.is_needed(answer.with_route(name=SAMPLED))
    named = replace(answer, route=replace(answer.route, name=route))
    assert search.is_needed(named)
    costs = [solution.cost for solution in search.solutions(named)]
    cost = np.polynomial.Polynomial.fromroots([VALLEYS[0]] * 2 + [VALLEYS[1]] * 2)
    cost += np.polynomial.Polynomial([TILT * VALLEYS[1], -TILT])
    assert min(costs) == pytest.approx(min(cost(cost.deriv().roots().real)), rel=1e-6, abs=1e-8)
    assert min(costs) < answer.cost - 0.05


@pytest.mark.parametrize("shares", [0.5, 3.0])
def test_a_violation_costs_what_exceeds_the_free_share(shares: float) -> None:
    problem = get("wall-1d", N=1)
    inputs = np.ones((1, problem.system.nu))
    position = roll_out(problem, inputs[None], problem.parameters.defaults).x[0, -1, 0]
    limit = position - shares * FREE_SHARE * problem.scales.x[0]
    limited = replace(problem, terminal=(Constraint("limit", problem.system.x[0], -np.inf, limit),))
    plain, penalized = (sampler_of(each).exact_cost(inputs) for each in (problem, limited))
    expected = PENALTY_WEIGHT * problem.scales.cost * max(shares - 1, 0) * FREE_SHARE
    assert penalized - plain == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_an_answer_costs_what_its_replay_costs_wherever_the_engine_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = get("wall-1d", N=5)
    answer, sampler = solve(problem, contact="exact", effort="quick"), sampler_of(problem)
    monkeypatch.setattr(sampler, "exact_cost", lambda inputs: np.inf)
    assert SampleSearch._penalized_cost(sampler, answer) == answer.audit.exact_cost
    broken = replace(answer, audit=replace(answer.audit, replay_broken=[None]))
    assert SampleSearch._penalized_cost(sampler, broken) == np.inf
