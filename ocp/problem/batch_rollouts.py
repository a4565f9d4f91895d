"""Rollouts of a problem by the batch engine: many samples at once, with the costs of the problem."""

from __future__ import annotations

from typing import Any

import casadi as ca

from dynamics.batch import RolloutFunction, RolloutPolicy
from dynamics.contact import Step
from ocp.problem.problem import Problem


def batch_rollouts(problem: Problem, step: Step, policy: RolloutPolicy, **engine: Any) -> RolloutFunction:
    """Return a function from policy parameters to the costs of the problem's rollouts under ``step``.

    ``engine`` are options of :class:`~dynamics.batch.RolloutFunction`; the function's argument ``p`` contains the
    values of ``step.p``.

    Raises ``UnsupportedOperation`` for costs that no engine can evaluate.
    """
    x, u, p = problem.system.x, problem.system.u, step.p.vector
    arguments = {"x": x, "u": u}
    arguments |= {} if problem.du is None else {"du": problem.du}
    arguments |= {"lam": problem.system.lam} if problem.uses_impulses else {}
    arguments["p"] = p
    stage_cost, terminal_cost = (ca.densify(ca.SX(cost)) for cost in (problem.stage_cost, problem.terminal_cost))
    return RolloutFunction(
        step,
        ca.Function("stage_cost", [*arguments.values()], [stage_cost], [*arguments], ["cost"]),
        ca.Function("terminal_cost", [x, p], [terminal_cost]),
        problem.N,
        policy,
        **engine,
    )
