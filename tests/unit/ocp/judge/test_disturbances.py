"""Survival under disturbances: parameters that are drawn, costs of draws, effects of delay and noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ocp import Gains, solve
from ocp.judge.disturbances import (
    DRAWS,
    FRICTION_SPREAD,
    MASS_SPREAD,
    DisturbedPolicy,
    _draws,
    disturbed_survival,
    friction_parameters,
    mass_parameters,
    measured_sizes,
)
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Rollout, roll_out
from problems import get
from tests.named import named

HILL = str(Path(__file__).parents[3] / "golden" / "cases" / "hill.py")


def test_frictions_and_masses_are_found_by_what_depends_on_them() -> None:
    hand = get("planar-hand")
    assert friction_parameters(hand) == ["friction"] and mass_parameters(hand) == ["m", "inertia"]
    assert friction_parameters(get("push-1d")) == []


def test_step_sizes_and_quaternions_carry_no_noise() -> None:
    cheetah, cube = named("half-cheetah"), named("push-cube")
    assert [cheetah.system.states[i].name for i in np.flatnonzero(measured_sizes(cheetah) == 0)] == ["h"]
    assert set(cube.system.rotating_entries) == set(np.flatnonzero(measured_sizes(cube) == 0)) != set()


def test_draws_lie_within_their_spread_and_depend_on_the_seed_alone() -> None:
    hand = get("planar-hand")
    evaluation = Evaluation(hand, hand.parameters.defaults)
    one, same, other = (_draws(evaluation, True, seed) for seed in (0, 0, 1))
    spreads = {"friction": FRICTION_SPREAD, "m": MASS_SPREAD, "inertia": MASS_SPREAD}
    for draws, names in ((one["friction ±20%"], ["friction"]), (one["masses ±10%"], ["m", "inertia"])):
        assert len(draws) == DRAWS
        for name in names:
            shares = np.array([draw.values[name] / evaluation.values[name] for draw in draws]) - 1
            assert np.ptp(shares) > spreads[name] and abs(shares).max() <= spreads[name]
        assert all(v == evaluation.values[n] for draw in draws for n, v in draw.values.items() if n not in names)
    for name, draws in one.items():
        pairs = zip(draws, same[name], strict=True)
        assert all(np.array_equal(a.noise, b.noise) and a.values == b.values for a, b in pairs)
    noise = "noise of 1% on the state"
    assert not np.array_equal(one[noise][0].noise, other[noise][0].noise)


def test_a_late_policy_answers_the_state_before() -> None:
    gains = Gains(np.ones((1, 1, 1)), np.zeros((1, 1)))
    for waiting, applied in ([], [1.0, 2.0, 3.0]), ([7.0], [7.0, 1.0, 2.0]), ([7.0, 8.0], [7.0, 8.0, 1.0]):
        policy = DisturbedPolicy(gains, np.zeros((3, 1)), [np.array([u]) for u in waiting])
        assert [float(policy.input(k, np.array([x]))[0]) for k, x in enumerate((1.0, 2.0, 3.0))] == applied


@pytest.mark.costly
def test_costs_of_draws_are_those_of_rollouts_at_a_quarter_of_the_step() -> None:
    solution = solve(HILL, "exact", effort="quick", N=10, a=1.0)
    evaluation = Evaluation(solution.problem, solution.values)
    arrays = [solution.data[name].values for name in ("x", "u", "lam", "gap")]
    plan = Rollout.from_trajectories(evaluation, solution.problem.exact_step, *arrays)
    rows = {row.disturbance: row for row in disturbed_survival(evaluation, plan, plan.u, factors=(4, 16))}
    assert list(rows) == ["h/4", "h/16", "masses ±10%", "inputs one step late"]
    assert rows["h/4"].median_cost == pytest.approx(solution.referee.refined_cost, rel=1e-12)
    fine = get(HILL, N=40, a=1.0)
    p = solution.values

    def cost(u: np.ndarray, values: dict[str, float]) -> float:
        x = roll_out(fine, np.repeat(u, 4, axis=1), {**values, "h": p["h"] / 4}, x0=plan.x[:, 0]).x[0, ::4]
        stages = p["h"] * (x[:-1, 0] ** 2 + p["w_u"] * u[0, :, 0] ** 2)
        return float(stages.sum() + p["w_end"] * x[-1, 0] ** 2 + p["w_rest"] * x[-1, 1] ** 2)

    for delay in (1, 2):
        late = np.concatenate([np.zeros((1, delay, 1)), plan.u[:, :-delay]], axis=1)
        row = disturbed_survival(evaluation, plan, plan.u, delay=delay)[-1]
        assert row.disturbance == "inputs one step late" and row.median_cost == pytest.approx(cost(late, p), rel=1e-9)
    costs = [cost(plan.u, draw.values) for draw in _draws(evaluation, False, 0)["masses ±10%"]]
    assert rows["masses ±10%"].largest_cost == pytest.approx(max(costs), rel=1e-9)
    assert rows["masses ±10%"].median_cost == pytest.approx(np.median(costs), rel=1e-9)
    allowed = 1.1 * solution.cost
    assert rows["masses ±10%"].survived == sum(c <= allowed for c in costs)
