"""Tests of an answer that decide whether to search on: it idles, lacks a certificate or fails the referee."""

from __future__ import annotations

import numpy as np

from ocp.judge.referee import PENETRATION_SHARE
from ocp.problem.evaluation import Evaluation
from ocp.solution import Solution

FEW_PAIRS = 20
"""Number of contact pairs up to which searches go on after one of them found a better answer."""
IDLE_SHARE = 0.9
"""Share of the cost of standing still above which an answer idles."""


def idles(solution: Solution) -> bool:
    """Return whether an answer costs more than :data:`IDLE_SHARE` of standing still, both without constant terms."""
    constant = Evaluation(solution.problem, solution.values).least_cost
    idling = solution.idle_cost - constant
    return bool(idling > 0 and solution.cost - constant > IDLE_SHARE * idling)


def replay_cost(solution: Solution) -> float:
    """Return the cost of an answer's exact replay, infinite where that failed."""
    cost = solution.audit.exact_cost
    return cost if np.isfinite(cost) else np.inf


def cost_to_beat(solution: Solution) -> float:
    """Return the cost below which another answer is better, infinite where this one has no certificate."""
    return replay_cost(solution) if solution.certificate.certified else np.inf


def is_poor(solution: Solution) -> bool:
    """Return whether an answer has no certificate or idles."""
    return idles(solution) or not solution.certificate.certified


def falls_short(solution: Solution) -> bool:
    """Return whether an answer has no certificate, does not survive the referee, or idles."""
    return is_poor(solution) or solution.referee.survives is False


def penetrates_between_nodes(solution: Solution) -> bool:
    """Return whether the plan penetrates anything between nodes by more than the referee tolerates."""
    deepest, depth = solution.referee.between, PENETRATION_SHARE * solution.problem.scales.gap
    return deepest is not None and deepest.amount > depth
