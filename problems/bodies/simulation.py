"""Simulation of published machines from the start states of their original environments."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, get_args

import casadi as ca
import numpy as np

from dynamics.contact import ContactLaw
from dynamics.systems.planar.machine import Gyroscopic, with_implicit_forces
from ocp.errors import InputError, NotConverged
from ocp.problem.problem import Problem
from ocp.problem.rollout import STEP_TOLERANCE, Rollout, roll_out
from problems.bodies.half_cheetah.machine import half_cheetah
from problems.bodies.hopper.machine import hopper
from problems.machines.machine import PublishedMachine
from problems.registry import get

MACHINES = {"hopper": hopper, "half-cheetah": half_cheetah}
"""Mapping from the name of a problem to the function that builds its machine."""


def simulation(
    name: str, steps: int = 50, seed: int = 0, gyroscopic: Gyroscopic = "implicit", **params: Any
) -> tuple[Problem, Any]:
    """Return the problem ``name`` over ``steps``, and the start state x0 (nx,) of its original environment.

    All spheres can touch the ground, and h is the environment's 0.05 s. The start is the machine's
    pose, lifted by 0.25 m, with uniform noise from ``seed`` of up to 0.005 for ``hopper`` and 0.1 for
    ``half-cheetah`` in every coordinate and velocity. With ``gyroscopic="implicit"``, velocity-dependent
    forces add no energy and no motion overflows
    (:func:`~dynamics.systems.planar.flight.gyroscopic_impulse`); in the problem these forces are explicit.
    ``params`` can set any parameter, including these.

    Raises :class:`~ocp.errors.InputError` for an unknown machine, another value of ``gyroscopic``, or a
    bad parameter.
    """
    if name not in MACHINES:
        raise InputError(f"{name!r} is not a machine that can be simulated; available: {', '.join(MACHINES)}")
    if gyroscopic not in get_args(Gyroscopic):
        raise InputError(f"gyroscopic must be 'explicit' or 'implicit', got {gyroscopic!r}")
    machine: PublishedMachine = MACHINES[name]()
    values: dict[str, Any] = {"spheres": "all", "N": steps, **params}
    x0 = machine.reset(seed)
    if name == "hopper":
        values.setdefault("h", machine.h)
    else:
        x0 = np.append(x0, values.setdefault("h_max", machine.h))
    problem = get(name, **values)
    if gyroscopic == "implicit":
        problem = replace(problem, system=with_implicit_forces(problem.system))
    return problem, x0


def simulate(
    name: str,
    steps: int = 50,
    inputs: np.ndarray | None = None,
    law: ContactLaw | None = None,
    seed: int = 0,
    gyroscopic: Gyroscopic = "implicit",
    **params: Any,
) -> Rollout:
    """Simulate a machine from the start of its original environment (:func:`simulation`).

    ``inputs`` (steps, nu) are the inputs of the motors, by default 0, and are not clipped, as in the
    source; ``law`` is the contact law, by default the exact one; for ``gyroscopic`` and ``params`` see
    :func:`simulation`. States (1, steps + 1, nx) are (q, v), for ``half-cheetah`` (q, v, h).

    Raises :class:`~ocp.errors.InputError` if the inputs have another shape, and :class:`~ocp.errors.NotConverged` if
    a step has no solution or if no solution was found; the message distinguishes the two cases.
    """
    problem, x0 = simulation(name, steps, seed, gyroscopic, **params)
    plan = np.zeros((steps, problem.system.nu)) if inputs is None else np.asarray(inputs, float)
    if plan.shape != (steps, problem.system.nu):
        raise InputError(
            f"{name}: the inputs have shape {plan.shape}, expected ({steps},"
            f" {problem.system.nu}), one row for each step"
        )
    values = problem.parameters.defaults
    try:
        return roll_out(problem, plan[None], values, law, x0[None])
    except NotConverged as lost:
        raise NotConverged(f"{name}: {_reason(problem, plan, law, x0, lost)}") from None


def _reason(problem: Problem, plan: np.ndarray, law: ContactLaw | None, x0: np.ndarray, lost: NotConverged) -> str:
    """Return a sentence that says why the rollout of ``plan`` (N, nu) from ``x0`` (nx,) failed with ``lost``."""
    step, system = problem.exact_step if law is None else law.close(problem.system), problem.system
    p = step.p.pack(problem.parameters.defaults)
    x = [x0]
    for u in plan:
        x_next, _, _, error = (np.array(value).ravel() for value in step.solve(x[-1], u, p))
        if not np.all(error <= STEP_TOLERANCE):
            break
        x.append(x_next)
    k, nq = len(x) - 1, system.nx // 2
    spins = np.abs(np.diff(np.array(x), axis=0)[:, 2:nq]).max(axis=1, initial=0) > 2 * np.pi
    wild = ""
    if spins.any():
        wild = (
            f"; since step {int(np.argmax(spins))} limbs turn by more than a whole turn in a step:"
            ' take gyroscopic="implicit", a smaller h or smaller inputs'
        )
    free = ca.Function("free", [system.x, system.u, step.p.vector], [system.reduced.a])
    if np.isfinite(np.array(free(x[-1], plan[k], p))).all():
        return f"{lost}; no other start of the search led to a solution either{wild}"
    return (
        f"step {k} has no solution: even without contact its motion overflows, at speeds of"
        f" {np.abs(x[-1][nq : 2 * nq]).max():.1e}{wild}"
    )
