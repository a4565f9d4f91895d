"""Cost of a plan with finer steps, made comparable with the cost of a plan with coarser steps."""

from __future__ import annotations

import casadi as ca
import numpy as np

from ocp.judge.step_size import step_size_kind
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import Rollout
from ocp.solution import Solution


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
