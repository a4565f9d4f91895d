"""Task of the half-cheetah for training policies: running."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.systems.contact_rows import Cone
from ocp.problem.task import Task
from problems.bodies.half_cheetah import problem as problem
from problems.bodies.half_cheetah.machine import half_cheetah
from problems.parameters import Parameters, choice, quantity, structure
from problems.spec import Citation
from problems.tasks.running import all_below, machine_task_fields, with_weights

name = "half-cheetah"
title = "Half-cheetah: run"
citation = Citation("zhang2023adaptive", "Adaptive barrier smoothing, sec. 7; reward and reset of Dojo's")
axes, draw, frames = problem.axes, problem.draw, problem.frames
training = {"all": {"iterations": 150}, "mbpo": {"iterations": 60, "hidden": (32, 32)}}
equations = """
max quad "mean of" sum_(t=0)^(N-1) r_t, quad r_t = dot(x)_(t+1) - 0.1 norm(u_t)^2
q = (x, z, theta, "three joints of the hind leg, three of the fore leg"), quad
  "dynamics as those of the problem half-cheetah with" h "fixed"
q_0 = q_"standing" + (0, 0.25 "m", 0, dots) + 0.1 xi, quad v_0 = 0.1 xi', quad
  xi, xi' "uniform on" [-1, 1]
"ends at a state that is not finite only"
"seen: all but" x; quad abs(u) <= 1 "(the source means it and does not enforce it)"
"""
LARGEST_STATE = float(np.finfo(float).max)
"""Absolute value of an entry of the state above which an episode ends: the largest finite float."""


class CheetahDynamics(Parameters):
    """Parameters of the half-cheetah's motion and of an episode."""

    h: float = quantity(problem.MACHINE.h, "s", "step size", above=0)
    horizon: int = structure(100, "steps of an episode, 80 in the source's training", least=1)
    friction: float = quantity(problem.MACHINE.friction, "1", "Coulomb's coefficient with the ground", least=0)
    spring_scale: float = quantity(1.0, "1", "factor of the joints' springs, 60 to 240 N m/rad", least=0)
    damping: float = quantity(1.0, "N m s/rad", "damping of each joint", least=0)
    base_damping: float = quantity(0.0, "N s/m", "drag on the torso, physically 0", least=0)


class Params(with_weights(CheetahDynamics, problem.MACHINE)):
    """Parameters of ``half-cheetah``; masses and inertias are symbols, so that they can be learned."""

    spheres: str = choice(("all", "legs", "feet"), "which parts may touch: all nine, shins and feet, or the feet")
    cone: Cone = choice(("linearised", "second-order"), "friction's cone: beta± and psi, or its eigenvalues")
    limits: int = structure(1, "1 for joint limits, 0 for none", most=1)


def build(params: Params) -> Task:
    """Build the task; the state is (q, v), and the reward [1] is the speed in m/s minus a cost of the inputs."""
    spheres = problem.SPHERES[params.spheres]
    system, common = machine_task_fields(name, params, half_cheetah, "spring_scale", spheres)
    x, nq = system.x, system.nx // 2
    return Task(
        **common,
        reward=system.x_next[nq] - 0.1 * ca.sumsqr(system.u),
        done=ca.logic_not(all_below(x, LARGEST_STATE)),
        lasts=ca.SX(0, 1),
        observation=x[1:],
    )
