"""Gains along a solution's plan: the choice of the best gains, and the solution with these gains as its policy."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from dynamics.contact import Step
from ocp.judge.policy_referee import policy_findings, policy_report
from ocp.judge.referee import Referee, referee_replay
from ocp.mpc.plan_policies import PlanRegulator, Weights
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Gains, Rollout, StateFeedback, roll_on
from ocp.solution import Solution
from ocp.solve.labelling import replay_variables

WEIGHTS = (
    Weights(),
    Weights(inputs=1.0),
    Weights(end=100.0),
    Weights(states=1.0, end=1.0, inputs=1e-3),
    Weights(states=100.0, end=100.0, inputs=0.1),
)
"""Weights of deviations from the plan that are tried in the computation of gains."""
SMOOTHING = (0.0, 1e-2, 0.1)
"""Smoothings of contact that are tried in the computation of gains, in characteristic impulses times gaps."""


def best_gains(evaluation: Evaluation, plan: Rollout) -> tuple[Gains, Referee]:
    """Return the gains along a plan that survive at the lowest cost (the larger of h and h/4), and their replay.

    Smoothed contacts are tried only if no gains survive without smoothing; if no gains survive at all, the cheapest
    gains are returned. Raises ``numpy.linalg.LinAlgError`` if a step has no linearisation.
    """
    regulator = PlanRegulator(evaluation, plan)
    candidates: list[tuple[bool, float, Gains, Referee]] = []
    for smoothing in SMOOTHING:
        for weights in WEIGHTS:
            gains = regulator.gains(weights, smoothing)
            outcome = referee_replay(evaluation, gains, plan.x[:, 0])
            fails = any(policy_findings(evaluation, plan, outcome))
            candidates.append((fails, _order_of_outcome(outcome), gains, outcome))
        if not all(candidate[0] for candidate in candidates):
            break
    best = min(candidates, key=lambda candidate: candidate[:2])
    return best[2:]


def with_gains(solution: Solution, gains: Gains, outcome: Referee) -> Solution:
    """Return the solution with ``gains`` as its policy, and with the referee's report on their replay."""
    evaluation, plan = plan_of(solution, solution.problem.exact_step)
    report = policy_report(evaluation, plan, outcome, solution.referee)
    data = replayed_data(solution, gains, outcome).assign(
        K=(("interval", "control", "state"), gains.K, {"units": "1"}),
        k=(("interval", "control"), gains.k, {"units": "1"}),
    )
    return replace(solution.with_data(data), gains=gains, referee=report)


def plan_of(solution: Solution, step: Step) -> tuple[Evaluation, Rollout]:
    """Return a solution's problem at its values, and its plan, which was made with ``step``."""
    evaluation = Evaluation(solution.problem, solution.values)
    arrays = (solution.arrays[name] for name in ("x", "u", "lam", "gap"))
    return evaluation, Rollout.from_trajectories(evaluation, step, *arrays)


def replayed_data(solution: Solution, policy: StateFeedback, outcome: Referee) -> Any:
    """Return the solution's data with the replays of a policy, under the exact law and by the referee."""
    evaluation = Evaluation(solution.problem, solution.values)
    replay, _ = roll_on(evaluation, policy, x0=solution.arrays["x"][:, 0])
    return solution.data.assign(replay_variables(evaluation, replay, outcome.replay))


def _order_of_outcome(outcome: Referee) -> float:
    """Return the cost by which candidates are compared: the larger of the costs at h and h/4."""
    costs = [outcome.cost] if outcome.refined is None else [outcome.cost, outcome.refined_cost]
    return max(costs) if all(map(math.isfinite, costs)) else math.inf
