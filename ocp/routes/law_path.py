"""A law's own path: its smoothing parameter from wide to wanted, and back from the exact law."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.contact.law import Schedule
from dynamics.systems import LAW_PREFIX
from ocp.programs.program import Program
from ocp.programs.solver import Point, Result
from ocp.routes.homotopy import PRIMAL, Homotopy, HomotopyPath, HomotopyStage, geometric

STAGE_ITERATIONS = 100
"""Before the last stage of a law's path an answer need not be sharp, only nearer."""
MU_LAST = 1e-9
"""Where the barrier law is left for the exact one."""
_PUSH = dict.fromkeys(("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac"), 1e-6)
_NEAR = {**PRIMAL, **_PUSH}
"""IPOPT options for a start without multipliers that is nearly the answer."""


def law_path(
    schedule: Schedule, target: float, start: float | None = None, factor: float | None = None
) -> HomotopyPath:
    """The law's parameter from its schedule's wide start (or ``start``) down to ``target``."""
    values = geometric(start or schedule.wide, target, factor or schedule.factor)
    label = schedule.parameter.removeprefix(LAW_PREFIX)

    def stage(value: float) -> HomotopyStage:
        options: dict[str, Any] = {}
        if value != values[0]:
            options["mu_init"] = 1e-5
        last = value == target
        if not last:
            options |= {"tol": 1e-6, "max_iter": STAGE_ITERATIONS}
        turned = {schedule.parameter: value}
        return HomotopyStage(label, value, parameters=turned, options=options, partial=not last)

    return HomotopyPath(values, stage)


def from_exact(
    follower: Homotopy, program: Program, x: np.ndarray, schedule: Schedule | None, value: float
) -> Result | None:
    """Solve at the law's value from the exact law's answer x, in this program's variables.

    The path from a wide law may end in a worse minimum, one with another contact schedule, and then
    the exact optimum is the better neighbour. Pairs are lifted onto the path of the law's mu. None
    where the solver does not converge, from a high or from a low barrier parameter of its own. It
    is to stay near: the usual push off the bounds, a hundredth of a unit, would lift every small
    impulse of every step above the path, and a long horizon with them.
    """
    x = x.copy()
    if program.pairs.size:
        mu = max(value, MU_LAST) if schedule is not None and schedule.is_mu else MU_LAST
        lam, gap = np.maximum(x[program.pairs], np.sqrt(mu) * 1e-3)
        active = lam > gap
        x[program.pairs] = np.where(active, lam, mu / gap), np.where(active, mu / lam, gap)
    for mu_init in (1e-3, 1e-6):
        stage = HomotopyStage("from exact", value, options={**_NEAR, "mu_init": mu_init})
        found = follower.solve_stage(stage, program, Point(x), False)
        if found.ok:
            return found
    return None
