"""Halve the step size and plan again until the answer no longer depends on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from ocp.errors import InputError
from ocp.judge.referee import place_of, refined_replay, step_place
from ocp.judge.route_report import Level, Refinement
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import Gains, roll_on
from ocp.programs.solver import Status
from ocp.solution import Solution

AGREED = 0.05
"""Share of a plan's cost to which that of its replay at half the step agrees with it."""
HALVINGS = 4
"""Of the step, at most: at h/16 a solve has sixteen times the variables."""
_SMALL = 1e-7


def level_of(found: Solution) -> Level:
    """Replay the inputs, or the policy, of a solution at half its step and compare the costs."""
    x0, h = found.data["x"].values[:, 0], float(found.data["time"][1])
    evaluation = Evaluation(found.problem, found.values)
    replay, _ = refined_replay(evaluation, _inputs(found), x0, by=2)
    replayed = float("nan") if replay is None else replay.cost
    difference = evaluation.cost_share(abs(replayed - found.cost), found.cost)
    return Level(h, found.problem.N, found.status.label, found.cost, replayed, difference <= AGREED)


def _inputs(found: Solution) -> np.ndarray | Gains:
    return found.data["u"].values if found.gains is None else found.gains


def growth(found: Solution) -> float:
    """How many times larger a small change of the start gets along a plan, at the most.

    By differences of replays, a state at a time, in characteristic sizes.
    """
    sizes, x0 = found.problem.scales.x, found.data["x"].values[0, 0]
    starts = x0 + _SMALL * np.vstack([0 * sizes, np.diag(sizes)])
    inputs, problem = _inputs(found), found.problem
    inputs = inputs if isinstance(inputs, Gains) else inputs[:1]
    x = roll_on(Evaluation(problem, found.values), inputs, problem.referee_step, starts)[0].x
    return float(np.nanmax(np.abs(x[1:] - x[0]) / sizes) / _SMALL)


def halved(problem: Problem, values: dict[str, float], by: int) -> dict[str, Any]:
    """Horizon and step size, by name, of the same duration in ``by`` times as many steps.

    Of a step size that is a state it is those parameters which bound it that are divided.
    Raises :class:`~ocp.errors.InputError` where h is no step of a discretisation.
    """
    why, name, place = step_place(problem.system)
    if why:
        raise InputError(f"refine halves the step of {problem.name}, but {why}; leave it out")
    if name:
        return {"N": by * problem.N, name: values[name] / by}
    ends = [ca.SX(problem.x_lower), ca.SX(problem.x_upper)]
    if problem.start is not None:
        ends += [ca.SX(problem.start.lower), ca.SX(problem.start.upper)]
    table = problem.parameters
    found = (place_of(end[place], table.vector) for end in ends if end.numel() > 1)
    names = dict.fromkeys(table.names[i] for i in found if i is not None)
    return {"N": by * problem.N} | {name: values[name] / by for name in names}


def refined(first: Solution, again: Callable[[dict[str, Any], Solution], Solution]) -> Solution:
    """Plan at h/2, h/4, ... from the last plan, until plan and replay at half the step agree.

    ``again`` solves at other values by name (:func:`halved`), from a solution. The last plan that
    is solved is returned, with every level in its ``route.refinement``. Raises as :func:`halved` does.
    """
    found, levels, stopped, iterations = first, [level_of(first)], "", first.iterations
    turned = [halved(first.problem, first.values, 2**k) for k in range(1, HALVINGS + 1)]
    while True:
        if levels[-1].status != Status.SOLVED.label:
            stopped = f"the plan at h = {levels[-1].h:.6g} is {levels[-1].status}"
        elif not levels[-1].agreed and len(levels) > HALVINGS:
            stopped = (
                f"h was halved {HALVINGS} times; a small change of the start gets"
                f" {growth(found):.2g} times larger along the plan, and so does the step's error"
            )
        if stopped or levels[-1].agreed:
            break
        finer = again(turned[len(levels) - 1], found)
        levels.append(level_of(finer))
        iterations += finer.iterations
        found = finer if finer.success else found
    return replace(found, iterations=iterations).with_route(refinement=Refinement(levels, stopped))
