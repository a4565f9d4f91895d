"""One solve: reproducible, from several starts, over seeded scenarios, with labelled data."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import xarray as xr

from dynamics.contact import Barrier, Exact, Randomized
from ocp import (
    Direct,
    Feedback,
    Problem,
    Scenarios,
    SingleShooting,
    Solution,
    Status,
    roll_out,
    solve,
)
from ocp.problem.rollout import initial_guesses
from ocp.solve.solve import new_session
from ocp.solve.starts import best_solution
from problems import get
from tests.findings import codes


def without_times(solution: Solution) -> dict[str, str]:
    """Return everything that is reported on a solution, except times."""
    record = {key: value for key, value in solution.record.items() if not key.endswith("_s")}
    stages = [replace(stage, seconds=0.0, evaluation_s=0.0) for stage in solution.stages]
    attempts = [replace(attempt, seconds=0.0) for attempt in solution.route.attempts]
    results = (solution.cost, solution.status, solution.audit, stages, solution.iterations, attempts)
    return {"results": json.dumps(results, default=str), "record": json.dumps(record, default=str)}


@pytest.mark.costly
@pytest.mark.parametrize(
    "arguments",
    [
        {"contact": Exact(), "n_starts": 3, "seed": 7},
        {"contact": Randomized(0.1, 4, seed=3, base=Barrier(mu=1e-2))},
        {"contact": Barrier(mu=1e-2), "method": SingleShooting(), "policy": Feedback()},
    ],
    ids=["starts", "randomized", "feedback"],
)
def test_the_same_seed_gives_the_same_answer_to_the_last_bit(arguments: dict[str, Any]) -> None:
    problem = {"scenarios": 3, "N": 6} if "policy" in arguments else {"N": 6}
    first, second = (solve(get("push-disc", **problem), **arguments) for _ in range(2))
    assert without_times(first) == without_times(second)
    drop = [name for name in first.data if "seconds" in str(name)]
    xr.testing.assert_identical(first.data.drop_vars(drop), second.data.drop_vars(drop))


# --- starts ----------------------------------------------------------------------------------


def test_guesses_come_from_the_seed_and_keep_the_start() -> None:
    session = new_session(get("cart-walls"), Exact())
    first, again = (
        initial_guesses(session.evaluation, 5, seed=3),
        initial_guesses(session.evaluation, 5, seed=3),
    )
    more, other = (
        initial_guesses(session.evaluation, 8, seed=3),
        initial_guesses(session.evaluation, 5, seed=4),
    )
    X, U = session.problem.initial_guess(session.problem.parameters.values)
    np.testing.assert_array_equal(first[0][0], X)
    np.testing.assert_array_equal(first[0][1], U)
    for (x, u), (x2, u2), (x3, _), (x4, _) in zip(first, again, more, other, strict=False):
        np.testing.assert_array_equal(x, x2)
        np.testing.assert_array_equal(u, u2)
        np.testing.assert_array_equal(x, x3, "more starts keep the first ones")
        np.testing.assert_array_equal(x[0], X[0], "x_0 is given")
        if x is not first[0][0]:
            assert np.abs(x - x4).max() > 0
            spread = np.std(x[1:] - X[1:])
            assert 0.15 < spread / (0.3 * session.problem.scaling.x) < 2


def two_wells() -> Problem:
    """Return wall-1d with a terminal cost that has its minimum at 0.5 m and a local one at 1.5 m."""
    problem = get("wall-1d", N=10)
    x, u = problem.system.x[0], problem.system.u
    wells = 10 * ((x - 1) ** 2 - 0.25) ** 2 + 0.5 * x
    return replace(problem, stage_cost=0.01 * u**2, terminal_cost=wells)


@pytest.mark.costly
def test_the_best_audited_answer_wins_and_the_others_are_listed() -> None:
    settings = {"homotopy": False}
    found = solve(two_wells(), Barrier(mu=1e-4), SingleShooting(), n_starts=8, settings=settings)
    assert [other.start for other in found.route.attempts] == list(range(8))
    costs = [other.cost for other in found.route.attempts if other.status == "solved"]
    assert max(costs) > min(costs) + 0.3, "both wells have been found"
    assert found.cost == min(costs)
    assert float(found.data["x"][0, -1, 0]) == pytest.approx(0.5, abs=0.1)
    chosen = [other for other in found.route.attempts if other.chosen]
    assert len(chosen) == 1
    assert chosen[0].cost == found.cost
    assert chosen[0].exact_cost == found.audit.exact_cost
    assert found.iterations == sum(other.iterations for other in found.route.attempts)


@pytest.mark.slow
def test_the_cart_reaches_its_best_known_minimum_from_eight_starts() -> None:
    found = solve(get("cart-walls"), Exact(), Direct(), n_starts=8)
    assert found.cost <= 186.588555 * (1 + 1e-6)


def test_an_audited_answer_beats_a_cheaper_one_that_is_none() -> None:
    base = solve(get("push-1d", N=3), Barrier(mu=1e-2))
    kinds = [Status.SOLVED, Status.NO_PROGRESS, Status.INEXACT, Status.ITERATION_LIMIT]
    answers = [replace(base, status=kind, cost=10.0 - i) for i, kind in enumerate(kinds)]
    assert best_solution(answers).status is Status.SOLVED
    assert best_solution(answers[1:]).status is Status.NO_PROGRESS
    nothing = replace(base, cost=float("nan"))
    assert best_solution([nothing, base]) is base


# --- scenarios -------------------------------------------------------------------------------


def test_scenarios_are_drawn_from_their_seed() -> None:
    scenarios = Scenarios(2000, (0.03, 0.1, 0.0, 0.0), seed=5)
    offsets = scenarios.offsets(4)
    np.testing.assert_array_equal(offsets, scenarios.offsets(4))
    assert np.abs(offsets - replace(scenarios, seed=6).offsets(4)).max() > 0.01
    np.testing.assert_allclose(offsets.std(axis=0), [0.03, 0.1, 0, 0], rtol=0.1)
    np.testing.assert_allclose(offsets.mean(axis=0), 0, atol=0.01)
    np.testing.assert_array_equal(Scenarios(1, (0.1,)).offsets(3), np.zeros((1, 3)))


def test_every_scenario_starts_at_its_own_state_and_the_cost_is_the_mean() -> None:
    problem = get("push-disc", N=6, scenarios=4, scenario_seed=2)
    found = solve(problem, Barrier(mu=1e-2), Direct(), settings={"homotopy": False})
    x = found.data["x"].values
    offsets = Scenarios(4, (0.03, 0.03, 0, 0), 2).offsets(4)
    np.testing.assert_allclose(x[:, 0], np.array([0, 0, -1, 0.2]) + offsets, atol=1e-15)
    u = found.data["u"].values
    np.testing.assert_array_equal(u, np.broadcast_to(u[:1], u.shape), "one plan for all")
    rolled = roll_out(problem, u, found.values, Barrier(mu=1e-2))
    assert found.cost == pytest.approx(rolled.costs.mean(), rel=1e-8)
    assert np.std(rolled.costs) > 1e-6


def test_replay_under_another_law_is_that_laws_rollout() -> None:
    problem = get("push-1d")
    found = solve(problem, Barrier(mu=1e-2))
    again = found.replay(Barrier(mu=1e-2))
    np.testing.assert_allclose(again.data["x"], found.data["x"], atol=1e-7)
    assert again.cost == pytest.approx(found.cost, rel=1e-7)
    exact = found.replay()
    assert exact.cost == found.audit.exact_cost
    np.testing.assert_array_equal(exact.data["x"], found.data["x_replay"])
    assert exact.cost > found.cost * 1.001, "a thick barrier's plan leans on it"
    assert f"exact law {exact.cost:.6g}" in found.verdict
    assert "relies-on-smoothing" in codes(found)


def test_the_policy_of_a_feedback_answer_is_what_it_did() -> None:
    problem = get("push-disc", N=6, scenarios=3)
    found = solve(problem, Barrier(mu=1e-2), Direct(), Feedback(), settings={"homotopy": False})
    assert found.gains is not None
    K, k, x = (found.data[name].values for name in ("K", "k", "x"))
    expected = np.einsum("tij,stj->sti", K, x[:, :-1]) + k
    np.testing.assert_allclose(found.data["u"], expected, atol=1e-7)
    again = found.replay(Barrier(mu=1e-2))
    np.testing.assert_allclose(again.data["x"], x, atol=1e-6)


@pytest.mark.costly
def test_the_cost_is_the_problems_without_the_penalty_on_gains() -> None:
    problem = get("push-disc", N=6, scenarios=3)
    found = solve(problem, Exact(), Direct(), Feedback(penalty=1e-2))
    assert found.success
    assert (found.data["K"].values ** 2).sum() > 1e-3, "the penalty has something to weigh"
    assert found.audit.exact_cost == pytest.approx(found.cost, rel=1e-5)
    assert f"cost {found.cost:.6g}, exact law {found.cost:.6g}" in found.verdict


# --- feedback against open loop --------------------------------------------------------------

FRESH = 100


def final_errors(plan: Any, found: Solution, seed: int = 1000) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal((FRESH, 2))
    starts = np.tile([0, 0, -1, 0.2], (FRESH, 1))
    starts[:, :2] += 0.03 * noise
    rolled = roll_out(get("push-disc"), plan, found.values, Exact(), starts)
    return np.linalg.norm(rolled.x[:, -1, :2] - [1.0, 0.5], axis=1)


@pytest.mark.slow
@pytest.mark.parametrize("law", [Exact(), Barrier(mu=1e-3)], ids=["exact", "barrier"])
@pytest.mark.parametrize("scenario_seed", [0, 1])
def test_gains_beat_the_open_loop_plan_under_exact_physics(law, scenario_seed: int) -> None:
    """Feedback gains reduce the mean final error over new starts at least fivefold."""
    plan = solve(get("push-disc"), law, Direct())
    several = get("push-disc", scenarios=8, scenario_seed=scenario_seed)
    gains = solve(several, law, Direct(), Feedback())
    assert plan.success and gains.success
    open_loop = final_errors(plan.data["u"].values, plan).mean()
    closed = final_errors(gains.gains, gains).mean()
    assert open_loop > 0.05, "the open-loop plan must be disturbed for the comparison to mean much"
    assert closed < open_loop / 5


@pytest.mark.costly
def test_gains_beat_the_open_loop_plan() -> None:
    """With a soft barrier law gains halve the mean final error, in a shorter test."""
    plan = solve(get("push-disc"), Barrier(mu=1e-3))
    gains = solve(get("push-disc", scenarios=8), Barrier(mu=1e-3), Direct(), Feedback())
    assert gains.success
    open_loop = final_errors(plan.data["u"].values, plan).mean()
    assert final_errors(gains.gains, gains).mean() < open_loop / 2
