"""Replays under the most exact contact model that fail, that are refined, and that follow a policy."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest

from ocp import Gains, NotConverged, roll_out
from ocp.judge.referee import referee_replay, survival_findings
from ocp.problem import rollout
from ocp.problem.rollout import Rollout, roll_on
from problems import get
from tests.unit.ocp.judge.test_referee import measured
from tests.unit.ocp.user_problems import (
    at_defaults,
    defaults,
    physical,
)


def test_a_replay_that_fails_is_kept_up_to_there() -> None:
    problem = get("planar-push")
    inputs = np.zeros((1, problem.N, 2))
    inputs[0, 7] = np.nan
    values, x0 = defaults(problem), problem.initial_states(physical(problem))
    report = referee_replay(at_defaults(problem), inputs, x0)
    assert report.failed is not None
    assert (report.failed.step, report.failed.scenario) == (7, 0)
    assert report.failed.contact.startswith("push")
    assert np.isnan(report.cost)
    assert np.isfinite(report.replay.x[0, :8]).all()
    assert np.isnan(report.replay.x[0, 8:]).all()
    with pytest.raises(NotConverged, match="at step 7 of scenario 0"):
        roll_out(problem, inputs, values, problem.referee_step, x0)
    plan = roll_out(problem, np.zeros((1, problem.N, 2)), values)
    reasons = survival_findings(at_defaults(problem), plan, report, measured(problem, report), [])
    assert reasons[0].code == "step-not-solved" and reasons[0].sentence.startswith("step 7 did not converge")


def test_other_scenarios_go_on_where_one_fails() -> None:
    problem = get("push-disc", scenarios=3)
    inputs = np.zeros((3, problem.N, 2))
    inputs[1, 4] = np.nan
    rolled, unsolved = roll_on(at_defaults(problem), inputs)
    assert unsolved is not None
    assert (unsolved.step, unsolved.scenario) == (4, 1)
    assert list(np.isnan(rolled.costs)) == [False, True, False]


def test_steps_of_many_pairs_are_those_of_one_graph(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scenarios and held inputs stay in order, to the last bit."""
    problem = get("planar-push")
    inputs = np.random.default_rng(0).standard_normal((3, problem.N, 2)) * problem.scales.u
    x0 = np.repeat(problem.initial_states(physical(problem)), 3, axis=0)

    def rolled() -> Rollout:
        return roll_on(at_defaults(problem), inputs, x0=x0, substeps=2)[0]

    in_one_graph = rolled()
    monkeypatch.setattr(rollout, "MAX_PAIRS", 0)
    assert np.isfinite(in_one_graph.costs).all() and np.ptp(in_one_graph.costs) > 0
    for one, other in zip(astuple(in_one_graph), astuple(rolled()), strict=True):
        assert np.array_equal(one, other, equal_nan=True)


def test_the_refined_cost_is_that_of_a_quarter_of_the_step() -> None:
    problem, fine = get("ball-bounce"), get("ball-bounce", N=160)
    inputs = np.random.default_rng(1).normal(size=(1, problem.N, 2))
    values = defaults(problem)
    x0 = problem.initial_states(physical(problem))
    rolled = roll_out(fine, np.repeat(inputs, 4, axis=1), values | {"h": values["h"] / 4}, x0=x0)
    coarse = rolled.x[:, ::4]
    stage = sum(
        float(problem.cost_terms(coarse[0, k], inputs[0, k], 0, 0, physical(problem))[0]) for k in range(problem.N)
    )
    end = float(problem.cost_terms(coarse[0, -1], 0, 0, 0, physical(problem))[1])
    report = referee_replay(at_defaults(problem), inputs, x0)
    assert report.refined_cost == pytest.approx(stage + end, rel=1e-12)
    assert report.refined_cost != pytest.approx(report.cost, rel=1e-6)


@pytest.mark.costly
def test_a_step_size_that_is_a_state_is_refined_too() -> None:
    problem, fine = get("half-cheetah", N=3), get("half-cheetah", N=12)
    x0 = problem.initial_states(physical(problem))
    inputs = np.random.default_rng(2).uniform(-0.2, 0.2, size=(1, 3, 6))
    quarter = x0.copy()
    quarter[0, -1] /= 4
    rolled = roll_out(fine, np.repeat(inputs, 4, axis=1), defaults(fine), x0=quarter)
    v = rolled.x[0, :-1:4, 9:18]
    cost = ((inputs**2).sum() + 1e-3 * (v**2).sum()) / 3
    report = referee_replay(at_defaults(problem), inputs, x0)
    assert report.refined_cost == pytest.approx(cost, rel=1e-9)
    assert report.replay.x[0, -1, -1] == x0[0, -1]


@pytest.mark.parametrize(
    ("name", "why"),
    [("push-1d", "part of the model"), ("wall-1d", "an input is an impulse per step")],
)
def test_where_a_step_cannot_be_refined_the_reason_is_told(name: str, why: str) -> None:
    problem = get(name)
    inputs = np.zeros((1, problem.N, problem.system.nu))
    report = referee_replay(at_defaults(problem), inputs, problem.initial_states(physical(problem)))
    assert np.isfinite(report.cost)
    assert np.isnan(report.refined_cost)
    assert why in report.refined_note


def test_a_policy_is_replayed_as_a_policy() -> None:
    problem = get("push-disc")
    K, k = np.zeros((1, 2, 4)), np.array([[0.2, 0.1]])
    K[0, :, 2:] = 0.5 * np.eye(2)
    x0 = problem.initial_states(physical(problem))
    report = referee_replay(at_defaults(problem), Gains(K, k), x0)
    x, u = report.replay.x[0], report.replay.u[0]
    np.testing.assert_allclose(u, np.clip(x[:-1] @ K[0].T + k[0], -3, 3), atol=1e-14)
    again = referee_replay(at_defaults(problem), report.replay.u, x0)
    np.testing.assert_array_equal(again.replay.x, report.replay.x)
