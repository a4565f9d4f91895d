"""Referee's report on a policy, by the outcome of its replays at h and at h/4; it need not reach the plan's states."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ocp.judge.findings import Finding, make_finding
from ocp.judge.referee import Referee, RefereeReport, outcome_findings
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Rollout


def policy_findings(evaluation: Evaluation, plan: Rollout, outcome: Referee) -> tuple[list[Finding], list[Finding]]:
    """Return the findings that say why a policy does not survive, at h and at h/4, each empty where it does.

    Each replay must cost at most 10 % more than ``plan``, and violate constraints and penetrate bodies by at most a
    tenth of their sizes (:func:`~ocp.judge.referee.outcome_findings`). States may differ from those of the plan.
    """
    if outcome.failed is not None:
        findings = [make_finding("step-not-solved", step=outcome.failed.brief)]
    else:
        findings = outcome_findings(evaluation, plan, outcome.replay)
    if outcome.refined is None:
        return findings, []
    if outcome.refined_note:
        return findings, [make_finding("replay-stops", note=outcome.refined_note)]
    return findings, outcome_findings(evaluation, plan, outcome.refined)


def policy_report(evaluation: Evaluation, plan: Rollout, outcome: Referee, of_plan: RefereeReport) -> RefereeReport:
    """Return the referee's report on a policy, from its replays and the report ``of_plan`` on the plan it follows."""
    findings, refined_findings = policy_findings(evaluation, plan, outcome)
    return replace(
        of_plan,
        cost=outcome.cost,
        gap=float(np.abs(outcome.replay.x - plan.x).max()),
        survives=not (findings or refined_findings),
        survives_at_h=not findings,
        reasons=[finding.sentence for finding in findings],
        refined_reasons=[finding.sentence for finding in refined_findings],
        findings=findings,
        refined_findings=refined_findings,
        refined_cost=outcome.refined_cost,
        refined_note=outcome.refined_note,
        replay_penetration=None,
        replay_between=None,
        broken=[],
        nonuniqueness="",
        branch_cost=float("nan"),
    )
