"""Gains over scenarios on the hill: their scenarios, merits and derivatives against a closed loop stepped here."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ocp import Solution, free, solve
from ocp.judge.disturbances import MASS_SPREAD, disturbed_survival, parameter_draws
from ocp.judge.referee import COST_SHARE
from ocp.mpc.plan_policies import PlanRegulator
from ocp.problem.rollout import Gains
from ocp.solve.best_gains import WEIGHTS, plan_of
from ocp.solve.scenario_gains import gains_over_scenarios
from ocp.solve.scenario_outcomes import ScenarioOutcomes, end_values
from problems import get

HILL = str(Path(__file__).parents[3] / "golden" / "cases" / "hill.py")


@cache
def plan() -> Solution:
    return solve(HILL, "exact", effort="quick", N=20)


@cache
def outcomes() -> ScenarioOutcomes:
    return ScenarioOutcomes(*plan_of(plan(), plan().problem.exact_step))


def regulators() -> list[Gains]:
    regulator = PlanRegulator(*plan_of(plan(), plan().problem.exact_step))
    return [regulator.gains(weights) for weights in WEIGHTS]


def closed_loop(gains: Gains, substeps: int, mass: float, push: float = 0.0) -> tuple[float, np.ndarray]:
    """Cost and states of the hill with another mass; the input at step 3 is changed by ``push``."""
    p = plan().values
    h, x, v, cost, states = p["h"] / substeps, p["start"], 0.0, 0.0, []
    for t, (K, k) in enumerate(zip(gains.K[:, 0], gains.k[:, 0], strict=True)):
        states.append([x, v])
        u = float(np.clip(K @ [x, v] + k, -p["u_max"], p["u_max"])) + push * (t == 3)
        cost += p["h"] * (x**2 + p["w_u"] * u**2)
        for _ in range(substeps):
            v += h * (p["a"] * x + u / mass)
            x += h * v
            if x < -1:
                return np.nan, np.array(states)
    return cost + p["w_end"] * x**2 + p["w_rest"] * v**2, np.array([*states, [x, v]])


def test_parameters_lie_at_the_ends_of_their_ranges() -> None:
    hand = get("planar-hand")
    values = end_values(hand, hand.parameters.defaults)
    shares = {tuple(round(v[n] / values[0][n] - 1, 9) for n in ("friction", "m", "inertia")) for v in values}
    assert len(values) == len(shares) == 7
    ends = {(0, a * MASS_SPREAD, b * MASS_SPREAD) for a in (-1, 1) for b in (-1, 1)}
    assert shares == {(0, 0, 0), (0.2, 0, 0), (-0.2, 0, 0), *ends}


@pytest.mark.costly
def test_a_merit_counts_replays_that_cost_too_much_and_has_their_mean_cost() -> None:
    m, limit, failures = plan().values["m"], (1 + COST_SHARE) * plan().cost, []
    for gains in regulators():
        worlds = [(4, m), (4, (1 - MASS_SPREAD) * m), (4, (1 + MASS_SPREAD) * m), (1, m)]
        costs = np.array([closed_loop(gains, *world)[0] for world in worlds])
        assert np.isfinite(costs).all()
        failures.append(int((costs > limit).sum()))
        merit, nominal = outcomes().merit(gains), costs[[0, 3]]
        assert merit.failures == (nominal > limit).sum()
        assert merit.excess == pytest.approx(np.maximum(nominal / limit - 1, 0).sum() * (1 + COST_SHARE), abs=1e-6)
        replayed = nominal if merit.failures else costs
        assert merit.others == (replayed > limit).sum()
        assert merit.cost == pytest.approx(replayed.mean(), rel=1e-9)
    assert max(failures) > 0


@pytest.mark.costly
def test_expansions_have_the_derivatives_of_differences_of_held_inputs() -> None:
    gains = regulators()[0]
    lighter = outcomes().expansions(gains)[1]
    mass = (1 - MASS_SPREAD) * plan().values["m"]
    states = closed_loop(gains, 4, mass)[1]
    assert lighter.x == pytest.approx(states, abs=1e-9)
    pushed = closed_loop(gains, 4, mass, 1e-4)[1] - closed_loop(gains, 4, mass, -1e-4)[1]
    assert lighter.dynamics[3, :, 2] == pytest.approx(pushed[4] / 2e-4, rel=1e-6)
    closed = lighter.dynamics[4, :, :2] + lighter.dynamics[4, :, 2:] @ gains.K[4]
    assert closed @ pushed[4] == pytest.approx(pushed[5], rel=1e-6)
    p, u = plan().values, lighter.u[:, 0]
    expected = 2 * p["h"] * np.stack([states[:-1, 0], 0 * u, p["w_u"] * u], axis=1)
    assert lighter.gradient == pytest.approx(expected, abs=1e-9)


@pytest.mark.costly
def test_a_step_size_that_is_a_state_changes_neither_gains_nor_replays() -> None:
    """A step size between 0.1 s and 0.1 s is that of the hill; at h/4 this state is a quarter."""
    freed = solve(replace(plan().problem, h=free(0.1, 0.1)), "exact", effort="quick")
    evaluation, rollout = plan_of(freed, freed.problem.exact_step)
    regulator = PlanRegulator(evaluation, rollout)
    for weights, fixed in zip(WEIGHTS, regulators(), strict=True):
        gains = regulator.gains(weights)
        assert np.all(gains.K[:, :, 2] == 0) and gains.K[:, :, :2] == pytest.approx(fixed.K, rel=1e-4, abs=1e-4)
    expected, freed_outcomes = outcomes().expansions(fixed)[2], ScenarioOutcomes(evaluation, rollout)
    expansion = freed_outcomes.expansions(gains)[2]
    assert expansion.x[:, :2] == pytest.approx(expected.x, abs=1e-5) and np.all(expansion.x[:, 2] == 0)
    assert expansion.dynamics[:, :2, [0, 1, 3]] == pytest.approx(expected.dynamics, abs=1e-6)
    assert expansion.gradient[:, [0, 1, 3]] == pytest.approx(expected.gradient, abs=1e-5)
    assert freed_outcomes.merit(gains) == pytest.approx(outcomes().merit(fixed), rel=1e-4)


@pytest.mark.costly
def test_they_are_better_than_every_regulator_and_survive_more_draws() -> None:
    evaluation, rollout = plan_of(plan(), plan().problem.exact_step)
    gains, outcome = gains_over_scenarios(evaluation, rollout)
    again = gains_over_scenarios(evaluation, rollout)[0]
    assert np.array_equal(gains.K, again.K) and np.array_equal(gains.k, again.k)
    best = min(outcomes().merit(candidate) for candidate in regulators())
    merit = outcomes().merit(gains)
    assert merit[:3] <= best[:3] and merit.cost < (1 - 1e-3) * best.cost
    assert outcome.cost == pytest.approx(closed_loop(gains, 1, plan().values["m"])[0], rel=1e-9)
    counts = [parameter_draws(disturbed_survival(evaluation, rollout, policy))[0] for policy in (*regulators(), gains)]
    assert counts[-1] >= max(counts[:-1])
