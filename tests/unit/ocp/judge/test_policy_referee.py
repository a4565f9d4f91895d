"""A policy is judged by its outcome: where each limit lies, at h and at h/4."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ocp import solve
from ocp.judge.policy_referee import policy_findings, policy_report
from ocp.judge.referee import COST_SHARE, referee_replay
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Rollout, Unsolved


@pytest.mark.costly
def test_limits_of_cost_constraints_and_bodies_at_h_and_at_a_quarter() -> None:
    solution = solve("ball-bounce", "exact", effort="quick")
    evaluation = Evaluation(solution.problem, solution.values)
    arrays = [solution.data[name].values for name in ("x", "u", "lam", "gap")]
    plan = Rollout.from_trajectories(evaluation, solution.problem.exact_step, *arrays)
    outcome = referee_replay(evaluation, plan.u, plan.x[:, 0])
    assert outcome.refined is not None
    assert policy_findings(evaluation, plan, outcome) == ([], [])
    changeable = plan.cost - evaluation.least_cost
    for share, survives in ((0.99 * COST_SHARE, True), (1.01 * COST_SHARE, False)):
        costs = np.array([plan.cost + share * changeable])
        at_h, at_quarter = (
            replace(outcome, **{part: replace(getattr(outcome, part), costs=costs)}) for part in ("replay", "refined")
        )
        assert bool(policy_findings(evaluation, plan, at_h)[0]) is not survives
        report = policy_report(evaluation, plan, at_quarter, solution.referee)
        assert (report.survives, report.survives_at_h) == (survives, True)
    stopped = replace(outcome, failed=Unsolved(3, "floor", 0, 1.0))
    assert [finding.code for finding in policy_findings(evaluation, plan, stopped)[0]] == ["step-not-solved"]
    sunk = replace(outcome, refined=replace(outcome.refined, x=outcome.refined.x - 0.5))
    assert "bodies-penetrate" in [finding.code for finding in policy_findings(evaluation, plan, sunk)[1]]
    moved = replace(outcome, replay=replace(outcome.replay, x=outcome.replay.x + 1e-3))
    assert policy_findings(evaluation, plan, moved) == ([], []), "states may differ"
