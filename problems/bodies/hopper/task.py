"""Task of the hopper for training policies: running without falling."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.systems.contact_rows import Cone
from ocp.problem.task import Task
from problems.bodies.hopper import problem as problem
from problems.bodies.hopper.machine import hopper
from problems.drawing import Shape
from problems.machines.machine import machine_shapes
from problems.parameters import Parameters, choice, quantity, structure
from problems.spec import Citation
from problems.tasks.running import all_below, machine_task_fields, with_weights

name = "hopper"
title = "Hopper: run without falling"
citation = Citation("zhang2023adaptive", "Adaptive barrier smoothing, sec. 7; reward, reset and end of Dojo's")
axes, frames = problem.axes, problem.frames
learner = "ars"
training = {
    # Within a few steps, a hundredth of the largest torque tilts the torso so far that the episode ends.
    "all": {"rest": (0.0, 1.21, *[0.0] * 10), "sigma": 3e-3, "rate": 1e-3},
    "ars": {
        "directions": 32,
        "top": 16,
        "spread": 3e-3,
        "rate": 1.5e-3,
        "iterations": 5000,
        "evaluate_every": 50,
        "episodes": 100,
    },
    # A single jerk gives the largest immediate reward; clipped rewards increase the cost of the fall after it.
    "mbpo": {"initial": 0.1, "sigma": 0.1, "rate": 3e-4, "reward_clip": 0.3, "hidden": (32, 32), "iterations": 80},
    "zopg": {"unroll": 100, "iterations": 400},
}
equations = """
max quad "mean of" sum_(t=0)^(N-1) r_t, quad r_t = dot(x)_(t+1) + 0.1 - 10^(-4) norm(u_t)^2
q = (x, z, theta, "thigh, leg, foot"), quad "dynamics as those of the problem hopper"
q_0 = q_"upright" + (0, 0.25 "m", 0, dots) + 0.005 xi, quad v_0 = 0.005 xi', quad
  xi, xi' "uniform on" [-1, 1]
"ends where" z <= 0.7 "m or" abs(theta) >= 0.2 "or a state's entry is not below 100"
"seen: all but" x, "velocities clipped to" plus.minus 10; quad abs(u) <= 1 "(the bound is ours)"
"""
LOWEST_TORSO = 0.7
"""Height of the torso at which an episode ends [m]."""
STEEPEST_PITCH = 0.2
"""Angle of the torso, forward or backward, at which an episode ends [rad]."""
LARGEST_STATE = 100.0
"""Absolute value of an entry of the state at which an episode ends [m, rad, m/s, rad/s]."""
FASTEST_SEEN = 10.0
"""Maximum absolute value of observed velocities, which are clipped [m/s, rad/s]."""
observation_bounds = {signal.name: (-FASTEST_SEEN, FASTEST_SEEN) for signal in problem.MACHINE.tree().velocities}


class HopperDynamics(Parameters):
    """Parameters of the hopper's motion and of an episode."""

    h: float = quantity(problem.MACHINE.h, "s", "step size", above=0)
    horizon: int = structure(100, "steps of an episode", least=1)
    friction: float = quantity(problem.MACHINE.friction, "1", "Coulomb's coefficient with the ground", least=0)
    spring: float = quantity(10.0, "N m/rad", "stiffness of each joint", least=0)
    damping: float = quantity(1.0, "N m s/rad", "damping of each joint", least=0)
    base_damping: float = quantity(0.0, "N s/m", "drag on the torso; 50 in the source as parsed, physically 0", least=0)


class Params(with_weights(HopperDynamics, problem.MACHINE)):
    """Parameters of ``hopper``; masses and inertias are symbols, so that they can be learned."""

    spheres: str = choice(("all", "outer", "foot"), "which parts may touch: all, all but the hip, or toe and heel")
    cone: Cone = choice(("linearised", "second-order"), "friction's cone: beta± and psi, or its eigenvalues")
    limits: int = structure(0, "1 for joint limits, as in the source's later version", most=1)


def build(params: Params) -> Task:
    """Build the task; the state is (q, v), and the reward is the speed in m/s plus 0.1 minus a cost of inputs.

    Inputs are bounded by one unit (200 N m), whereas the source has no bounds. A state that is not finite
    also ends the episode.
    """
    system, common = machine_task_fields(name, params, hopper, "spring", problem.SPHERES[params.spheres])
    x, u, nq = system.x, system.u, system.nx // 2
    lasts = ca.vertcat(x[1] - LOWEST_TORSO, STEEPEST_PITCH - x[2], STEEPEST_PITCH + x[2], LARGEST_STATE**2 - x**2)
    standing = ca.logic_and(x[1] > LOWEST_TORSO, ca.fabs(x[2]) < STEEPEST_PITCH)
    clipped_velocities = ca.fmax(-FASTEST_SEEN, ca.fmin(x[nq:], FASTEST_SEEN))
    return Task(
        **common,
        reward=system.x_next[nq] + 0.1 - 1e-4 * ca.sumsqr(u),
        done=ca.logic_not(ca.logic_and(standing, all_below(x, LARGEST_STATE))),
        lasts=lasts,
        observation=ca.vertcat(x[1:nq], clipped_velocities),
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw links, spheres and the ground."""
    return machine_shapes(problem.MACHINE, state)
