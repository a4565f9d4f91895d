"""A task's episode from one start as an optimal control problem."""

from __future__ import annotations

import casadi as ca
import numpy as np

from ocp.errors import InputError
from ocp.problem import Constraint, Problem, Scaling
from ocp.task import Task

MARGIN = 1e-6
"""What a plan keeps from the end of its episode, in the units of ``Task.lasts``, since an episode
ends on the border itself and a solver keeps its constraints up to 1e-8."""


def planned_problem(task: Task, x0: np.ndarray, scaling: Scaling | None = None) -> Problem:
    """Minimise minus the return of an episode of full length that starts at ``x0`` (nx,).

    The cost is minus ``sum_t reward(x_t, u_t, x_{t+1}) + final(x_N)``, t < N. A reward
    ``a(x_{t+1}) + b(x_t, u_t)`` becomes the stage cost ``-a(x_t) - b(x_t, u_t)`` and the terminal
    cost ``-a(x_N) - final(x_N) + a(x_0)``, with the same sum. ``Task.lasts`` is kept at all states
    that a reward is gained from, and at the last one where ``final`` is gained there; an episode
    that ends before gets nothing more, and no such episode is planned.

    Raises :class:`~ocp.errors.InputError` where x0 has another size or has ended already, where the
    reward is no such sum, and where ``done`` depends on x and ``lasts`` is not said.
    """
    system = task.system
    start = np.asarray(x0, dtype=float)
    if start.shape != (system.nx,) or not np.isfinite(start).all():
        raise InputError(
            f"{task.name}: a plan starts at {system.nx} finite numbers, one a state, got"
            f" {np.array2string(start, threshold=8)}"
        )
    if bool(task.ends(start, task.parameters.values)):
        raise InputError(
            f"{task.name}: an episode from this start is over before its first step; start where it"
            " goes on"
        )
    after, before = _parts(task, start)
    final = ca.SX(task.final)
    lasting = _survival_constraint(task)
    return Problem(
        name=task.name,
        system=system,
        N=task.horizon,
        stage_cost=-(after + before),
        terminal_cost=ca.substitute(after, system.x, ca.DM(start)) - after - final,
        x0=ca.SX(ca.DM(start)),
        parameters=task.parameters,
        u_lower=ca.SX(ca.DM(task.lower)),
        u_upper=ca.SX(ca.DM(task.upper)),
        path=lasting,
        terminal=() if final.is_zero() else lasting,
        scaling=scaling or Scaling(),
    )


def _parts(task: Task, start: np.ndarray) -> tuple[ca.SX, ca.SX]:
    """``a(x)`` and ``b(x, u)`` of ``reward = a(x_next) + b(x, u)``."""
    system, reward = task.system, ca.SX(task.reward)
    given = ca.vertcat(system.x, system.u)
    slope = ca.jacobian(reward, system.x_next)
    if ca.depends_on(slope, given):
        used = {str(symbol) for symbol in ca.symvar(slope)}
        mixed = ", ".join(str(symbol) for symbol in ca.symvar(given) if str(symbol) in used)
        raise InputError(
            f"{task.name}: the reward's part in x_next depends on {mixed} too, which"
            " no stage cost in (x, u) can say; write the reward as a(x_next) + b(x, u)"
        )
    usual = ca.vertcat(ca.DM(start), ca.DM(task.lower + task.upper) / 2)
    after = ca.substitute(reward, given, usual)
    constant = ca.substitute(after, system.x_next, ca.DM(start))
    before = ca.substitute(reward, system.x_next, ca.DM(start)) - constant
    return ca.substitute(after, system.x_next, system.x), before


def _survival_constraint(task: Task) -> tuple[Constraint, ...]:
    """That the episode goes on."""
    if task.lasts is None:
        if ca.depends_on(ca.SX(task.done), task.system.x):
            raise InputError(
                f"{task.name}: done depends on the state, but what a plan must keep so that its"
                " episode goes on is not said; give Task.lasts"
            )
        return ()
    kept = ca.SX(task.lasts)
    return (Constraint("episode goes on", kept, MARGIN, ca.inf),) if kept.numel() else ()
