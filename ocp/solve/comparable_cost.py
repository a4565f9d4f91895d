"""Costs of remedies, made comparable with the cost of the first plan, and the largest cost that survives."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from ocp.judge.idling import cost_span
from ocp.judge.referee import Referee
from ocp.judge.route_report import Rung
from ocp.judge.step_size import step_size_kind
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import Rollout
from ocp.solution import Solution

DEARER_SHARE = 1e-3
"""Relative cost difference from which a remedy counts as more expensive than the first plan."""
USEFUL_SHARE = 0.5
"""Largest excess cost of a remedy that survives, as a fraction of what a plan can change."""


def largest_surviving_cost(first: Solution, evaluation: Evaluation, plan: Rollout) -> float:
    """Return the largest cost at which a remedy for the ``first`` solution, with this ``plan``, survives.

    The limit is J + :data:`USEFUL_SHARE` · min(J_idle - J, span), and at least J + :data:`DEARER_SHARE` · |J|, less
    constant terms. J is the plan's cost, J_idle the cost of doing nothing (:func:`~ocp.judge.idling.idle_cost`, left
    out if NaN), and span the change of the cost as all states and inputs change by a characteristic size, which
    limits the cost of doing nothing in unstable problems (:func:`~ocp.judge.idling.cost_span`). The limit is infinite
    if the first plan is not solved, since its cost then bounds nothing.
    """
    if not first.success:
        return math.inf
    changeable = float(np.fmin(first.idle_cost - first.cost, cost_span(evaluation, plan)))
    return first.cost + max(USEFUL_SHARE * changeable, DEARER_SHARE / first.cost_share(1.0, first.cost))


def comparable_cost(coarse: Solution, problem: Problem, finer: Rollout) -> float:
    """Return the cost of ``finer``, a rollout of ``problem``, for comparison with ``coarse``, whose N divides its N.

    If the stage cost depends on the step size, as an integral does, the result is the rollout's cost. Otherwise the
    cost is a sum over nodes, which grows with their number; it is then summed over the nodes of ``coarse``, with the
    impulses between two nodes added. The result is NaN if the cost depends on impulses and the problems have different
    contacts.
    """
    target = coarse.problem
    factor = problem.N // target.N
    if factor == 1 or ca.depends_on(problem.stage_cost, ca.SX(problem.system.h)):
        return finer.cost
    step_size = step_size_kind(problem.system)
    x, u = finer.x[:, ::factor].copy(), finer.u[:, ::factor]
    if step_size.kind == "state":
        x[:, :, step_size.state] *= factor
    impulses = finer.impulses.reshape(len(x), target.N, factor, -1).sum(axis=2)
    if impulses.shape[2] != target.system.nlam:
        impulses = np.full((*u.shape[:2], target.system.nlam), np.nan)
    return float(Evaluation(target, coarse.values).trajectory_costs(x, u, impulses).mean())


def rung_of(name: str, first: Solution, solution: Solution, plan: Rollout, outcome: Referee) -> Rung:
    """Return the rung of a remedy's ``solution`` with its ``plan``, with costs comparable with those of ``first``.

    ``outcome`` are the replays of its inputs or its policy. A remedy that is more expensive than the first plan at its
    own step size has a note.
    """
    cost, refined_cost = (
        math.nan if replay is None else comparable_cost(first, solution.problem, replay)
        for replay in (outcome.replay, outcome.refined)
    )
    share = first.cost_share(comparable_cost(first, solution.problem, plan) - first.cost, first.cost)
    return Rung(
        name,
        h=float(solution.arrays["time"][1]),
        N=solution.problem.N,
        status=solution.status.label,
        planned=solution.cost,
        cost=cost,
        refined_cost=refined_cost,
        survives=bool(solution.success and solution.referee.survives),
        iterations=solution.iterations,
        note=f"{100 * share:.2g} % more expensive than the plan at its own step size" if share > DEARER_SHARE else "",
    )
