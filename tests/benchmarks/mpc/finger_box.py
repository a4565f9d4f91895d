"""A finger of two links, read from an MJCF file, pushes a box over a table; seen from above, in the plane of x and z.

The box slides with viscous friction, in place of the table's dry friction, which no joint has here. The finger starts
beside the box's near face with its elbow bent, and pushes with its tip.
"""

from pathlib import Path

import casadi as ca
import numpy as np

from ocp import Problem, Scaling
from problems import robots
from problems.parameters import Parameters, quantity, structure, table

name = "finger-box"
title = "A finger of two links pushes a box"
axes = ("x [m]", "z [m]")
robot = robots.load(Path(__file__).with_suffix(".xml"))
START = np.array([-1.0, 2.0, 0.0, 0.0, 0.0])  # shoulder, elbow [rad]; box [m, m, rad]


class Params(Parameters):
    """Parameters of the push; the finger and the box are in the file."""

    goal_x: float = quantity(0.1, "m", "goal of the box along x")
    goal_z: float = quantity(0.0, "m", "goal of the box along z")
    effort: float = quantity(0.01, "1", "weight of the inputs", least=0)
    w_end: float = quantity(1000.0, "1/m^2", "terminal weight of the box's place", least=0)
    h: float = quantity(0.04, "s", "step size", above=0)
    N: int = structure(20, "number of steps", least=1)


def build(params: Params) -> Problem:
    """Build the problem; the state is the finger's angles, the box's place and angle, and their velocities."""
    p = table(params)
    system = robot.machine.system(name, p, h=p["h"], friction=robot.coefficients)
    lower, upper = robot.controls.T
    x, nq = system.x, len(START)
    away = ca.sumsqr(x[2:4] - ca.vertcat(p["goal_x"], p["goal_z"]))
    return Problem(
        name,
        system,
        params.N,
        stage_cost=p["effort"] * ca.sumsqr(system.u) + 10 * away + 0.1 * x[4] ** 2,
        terminal_cost=p["w_end"] * away + 10 * x[4] ** 2 + 0.1 * ca.sumsqr(x[nq:]),
        parameters=p,
        x0=ca.vertcat(ca.SX(START), ca.SX.zeros(nq)),
        u_lower=lower,
        u_upper=upper,
        scaling=Scaling(impulse=0.05, gap=0.1),
    )


def draw(params: Params, state: np.ndarray):
    """Return the shapes of the finger and the box at one state."""
    return robot.shapes(state)
