"""Cold paths of relaxations: extrapolated costs, paths that are given up, and plans that the usual route misses."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from dynamics.contact import Exact
from ocp import Direct, OpenLoop
from ocp.programs.solver import Solver
from ocp.routes import complementarity
from ocp.routes.complementarity import FURTHER_PATHS, RelaxationPlan, by_strategy, solve_pairs
from ocp.routes.homotopy import Homotopy, RouteResult, extrapolate
from ocp.routes.relaxations import DEFAULT_STRATEGY, STRATEGIES, ColdScholtes, Strategy
from ocp.routes.session import Session
from problems import get


@functools.cache
def session(name: str) -> Session:
    return Session(get(name), Exact(), Direct(), OpenLoop())


def follower_of(name: str) -> Homotopy:
    return Homotopy(session(name).nlp_of, Solver(), session(name).values)


def solved(name: str, *further_paths: Strategy) -> RouteResult:
    mu = session(name).problem.natural_scales.mu
    plan = RelaxationPlan(STRATEGIES[DEFAULT_STRATEGY], mu, session(name).first_point, further_paths=further_paths)
    return solve_pairs(follower_of(name), plan)


@functools.cache
def followed(name: str, cost_limit: float = np.inf) -> tuple[Homotopy, RouteResult]:
    """Return the follower and the outcome of the first cold path."""
    follower, mu, cold_path = follower_of(name), session(name).problem.natural_scales.mu, ColdScholtes()
    plan = RelaxationPlan(cold_path, mu, session(name).first_point)
    return follower, by_strategy(follower, plan, cold_path, cost_limit)


@pytest.mark.parametrize("slope", [-3.0, 0.0, 2.0])
def test_costs_linear_in_t_are_extrapolated_exactly(slope: float) -> None:
    costs = [(t, 5.0 + slope * t) for t in (1.0, 0.1, 0.01)]
    assert all(extrapolate(costs[:n]) == pytest.approx(5.0) for n in (2, 3))
    assert extrapolate(costs[:1]) == costs[0][1]


def test_the_extrapolation_predicts_the_cost_at_the_end_of_a_path() -> None:
    follower, outcome = followed("push-box")
    costs = [(line.value, line.cost) for line in follower.trace.records if line.label == "cold t"]
    predicted = [extrapolate(costs[: n + 1]) for n in range(len(costs))]
    assert outcome.finished
    assert np.all(np.diff([cost for _, cost in costs][:4]) > 0)
    np.testing.assert_allclose(predicted[2:], outcome.result.f, rtol=2e-3)


@pytest.mark.parametrize(("share", "finished"), [(1.01, True), (0.99, False)])
def test_a_path_is_given_up_if_it_promises_no_lower_cost(share: float, finished: bool) -> None:
    _, reference = followed("push-box")
    limited, outcome = followed("push-box", share * reference.result.f)
    assert outcome.finished == finished
    if not finished:
        assert all(line.label == "cold t" for line in limited.trace.records)
        assert len(limited.trace.records) < 7


@pytest.mark.costly
def test_a_push_is_found_that_the_central_path_misses() -> None:
    # A plain Scholtes loop ends at 5.599, the central path at 6.790.
    assert solved("push-box").result.f == pytest.approx(6.7897, rel=1e-4)
    assert solved("push-box", FURTHER_PATHS[0]).result.f <= 5.599


@pytest.mark.cheap_cases("wall-1d")
@pytest.mark.parametrize("name", ["wall-1d", "cart-walls", "hopper-1d", "finger-disc"])
def test_no_answer_is_dearer_than_without_cold_paths(name: str) -> None:
    without, outcome = solved(name), solved(name, *FURTHER_PATHS)
    assert outcome.finished
    assert outcome.result.f <= without.result.f + 1e-7 * abs(without.result.f)


def test_further_paths_take_a_share_of_the_iterations_before_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a share none is followed; a path ends at the stage in which its share is used up."""
    usual = solved("finger-disc").trace
    for share, paths in ((0.0, 0), (0.5, 1)):
        monkeypatch.setattr(complementarity, "FURTHER_SHARE", share)
        records = solved("finger-disc", *FURTHER_PATHS).trace.records[len(usual.records) :]
        iterations = [line.iterations for line in records]
        assert len([line for line in records if line.value == records[0].value]) == paths
        assert sum(iterations[:-1]) < max(share * usual.iterations, 1)
