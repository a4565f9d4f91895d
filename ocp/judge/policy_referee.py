"""Referee's report on a policy from its replays at h and at h/4; states may differ from those of the plan."""

from __future__ import annotations

from ocp.judge.findings import Finding, make_finding
from ocp.judge.referee import Referee, RefereeReport, outcome_findings, quarter_step_findings
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Rollout


def policy_findings(evaluation: Evaluation, plan: Rollout, outcome: Referee) -> tuple[list[Finding], list[Finding]]:
    """Return findings on why a policy does not survive, at h and at h/4; a list is empty if the policy survives.

    Each replay must cost at most 10 % more than ``plan``, and violate constraints and penetrate bodies by at most a
    tenth of their sizes (:func:`~ocp.judge.referee.outcome_findings`). States may differ from those of the plan.
    """
    if outcome.failed is not None:
        findings = [make_finding("step-not-solved", step=outcome.failed.brief)]
    else:
        findings = outcome_findings(evaluation, plan, outcome.replay)
    return findings, quarter_step_findings(evaluation, plan, outcome)


def policy_report(evaluation: Evaluation, plan: Rollout, outcome: Referee, of_plan: RefereeReport) -> RefereeReport:
    """Return the referee's report on a policy, from its replays and the report ``of_plan`` on the plan it follows."""
    of_plan_details = {name: getattr(of_plan, name) for name in ("penetration", "between", "force_distance")}
    return RefereeReport.of_replay(outcome, plan, *policy_findings(evaluation, plan, outcome), **of_plan_details)
