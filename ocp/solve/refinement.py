"""Refinement of a plan: its step size is halved until the solution no longer depends on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from ocp.errors import InputError
from ocp.judge.referee import refined_replay
from ocp.judge.route_report import Level, Refinement
from ocp.judge.step_size import index_of_symbol, step_size_kind
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import roll_on
from ocp.programs.solver import Status
from ocp.solution import Solution

AGREED = 0.05
"""Largest relative difference between the costs of a plan and of its replay at h/2 that agree."""
HALVINGS = 4
"""Maximum number of halvings; at h/16 a solve has sixteen times the variables."""
_PERTURBATION = 1e-7
"""Perturbation of an initial state, in its characteristic size, whose growth is measured."""


def replay_level(solution: Solution) -> Level:
    """Return a level with the cost of a solution and the cost of its inputs or policy replayed at half the step."""
    problem, x0 = solution.problem, solution.data["x"].values[:, 0]
    evaluation = Evaluation(problem, solution.values)
    replay, _ = refined_replay(evaluation, solution.inputs, x0, factor=2)
    replayed_cost = float("nan") if replay is None else replay.cost
    share = evaluation.cost_share(abs(replayed_cost - solution.cost), solution.cost)
    h = float(solution.data["time"][1])
    return Level(h, problem.N, solution.status.label, solution.cost, replayed_cost, share <= AGREED)


def perturbation_growth(solution: Solution) -> float:
    """Return the largest factor by which a small change of the initial state grows along a plan.

    Each replay starts with one state changed; changes are in characteristic sizes.
    """
    problem, inputs = solution.problem, solution.inputs
    sizes = problem.scales.x
    starts = solution.data["x"].values[0, 0] + _PERTURBATION * np.vstack([0 * sizes, np.diag(sizes)])
    inputs = inputs[:1] if isinstance(inputs, np.ndarray) else inputs
    x = roll_on(Evaluation(problem, solution.values), inputs, problem.referee_step, starts)[0].x
    return float(np.nanmax(np.abs(x[1:] - x[0]) / sizes) / _PERTURBATION)


def divided_step(problem: Problem, values: dict[str, float], factor: int) -> dict[str, Any]:
    """Return a dict of N and the step size parameter for the same duration in ``factor`` times as many steps.

    If the step size is a state, the parameters of its bounds are divided. Raises :class:`~ocp.errors.InputError` if h
    is not the step of a discretisation.
    """
    step_size = step_size_kind(problem.system)
    if step_size.kind == "fixed":
        raise InputError(f"refine halves the step of {problem.name}, but {step_size.reason}; leave it out")
    if step_size.kind == "parameter":
        return {"N": factor * problem.N, step_size.parameter: values[step_size.parameter] / factor}
    bounds = [ca.SX(problem.x_lower), ca.SX(problem.x_upper)]
    if problem.start is not None:
        bounds += [ca.SX(problem.start.lower), ca.SX(problem.start.upper)]
    table = problem.parameters
    indices = (index_of_symbol(bound[step_size.state], table.vector) for bound in bounds if bound.numel() > 1)
    names = dict.fromkeys(table.names[i] for i in indices if i is not None)
    return {"N": factor * problem.N} | {name: values[name] / factor for name in names}


def refine_step_size(coarse: Solution, solve_again: Callable[[dict[str, Any], Solution], Solution]) -> Solution:
    """Solve at h/2, h/4, ... from the last plan, until a plan and its replay at half the step agree in cost.

    ``solve_again`` solves with the values of :func:`divided_step`, starting at a solution. Returns the last
    solved plan, with every level in its ``route.refinement``. Raises as :func:`divided_step` does.
    """
    finest, levels, stopped, iterations = coarse, [replay_level(coarse)], "", coarse.iterations
    divided = [divided_step(coarse.problem, coarse.values, 2**k) for k in range(1, HALVINGS + 1)]
    while True:
        if levels[-1].status != Status.SOLVED.label:
            stopped = f"the plan at h = {levels[-1].h:.6g} is {levels[-1].status}"
        elif not levels[-1].agreed and len(levels) > HALVINGS:
            stopped = (
                f"h was halved {HALVINGS} times; a small change of the start gets"
                f" {perturbation_growth(finest):.2g} times larger along the plan, and so does the step's error"
            )
        if stopped or levels[-1].agreed:
            break
        finer = solve_again(divided[len(levels) - 1], finest)
        levels.append(replay_level(finer))
        iterations += finer.iterations
        finest = finer if finer.success else finest
    return replace(finest, iterations=iterations).with_route(refinement=Refinement(levels, stopped))
