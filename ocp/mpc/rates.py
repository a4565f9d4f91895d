"""Rate of control: samples per step of a plan, and plans and gains between their steps."""

from __future__ import annotations

import numpy as np

from dynamics.settings import read_value
from ocp.errors import InputError
from ocp.judge.step_size import step_size_kind
from ocp.mpc.receding import Values
from ocp.mpc.stages import Plan
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import Gains

MAX_SAMPLES_PER_STEP = 10_000
"""Maximum number of samples of the controller per step of its plans."""
WHOLE_NUMBER_TOLERANCE = 1e-6
"""Relative difference up to which a number of samples per step counts as whole."""


def samples_per_step(problem: Problem, rate: float | None, parameters: Values) -> int:
    """Return the number of samples ``r = rate h`` per step of a plan; 1 if ``rate`` [Hz] is None.

    ``parameters`` are values that differ from the problem's defaults.

    Raises :class:`~ocp.errors.InputError` if r is not a whole number, and for r > 1 if the step size of the
    problem is not a parameter, since the plant takes steps of h / r.
    """
    if rate is None:
        return 1
    defaults = problem.parameters.defaults
    values = {name: float(v) for name, v in parameters.items() if name in defaults and isinstance(v, int | float)}
    h = float(Evaluation(problem, defaults | values).node_times()[1])
    r = round(min(rate * h, 2 * MAX_SAMPLES_PER_STEP))
    read_value(f"rate {rate:g} Hz: samples per step of {h:g} s", r, int, most=MAX_SAMPLES_PER_STEP)
    if r < 1 or abs(rate * h - r) > WHOLE_NUMBER_TOLERANCE * r:
        raise InputError(
            f"a rate of {rate:g} Hz is {rate * h:.4g} samples per step of {h:g} s; give a multiple of {1 / h:g} Hz"
        )
    step_size = step_size_kind(problem.system)
    if r > 1 and step_size.kind != "parameter":
        reason = step_size.reason or "the step size is a state"
        raise InputError(f"{problem.name}: a rate above {1 / h:g} Hz needs a plant with smaller steps, but {reason}")
    return r


def interpolate_plan(plan: Plan, shifted: Plan, share: float) -> Plan:
    """Return ``plan + share (shifted - plan)``, the plan shifted by a share of a step; ``shifted`` if it is 1."""
    if share == 1:
        return shifted
    pairs = ((getattr(plan, name), getattr(shifted, name)) for name in ("x", "u", "lam", "gap"))
    return Plan(*(first + share * (second - first) for first, second in pairs))


def gains_along(plan: Plan, K: np.ndarray, r: int) -> Gains:
    """Return the gains of ``u = u_plan + K (x - x_plan)`` with K (N, nu, nx), r rows for each step of the plan.

    Between steps x_plan and u_plan are interpolated; K is that of the step.
    """
    x, u = plan.x[:-1], plan.u
    if r > 1:
        share = (np.arange(len(u) * r) % r / r)[:, None]
        u_next = np.concatenate([u[1:], u[-1:]])
        x, x_next, u, u_next, K = (np.repeat(v, r, axis=0) for v in (x, plan.x[1:], u, u_next, K))
        x, u = x + share * (x_next - x), u + share * (u_next - u)
    return Gains(K, u - np.einsum("kij,kj->ki", K, x))
