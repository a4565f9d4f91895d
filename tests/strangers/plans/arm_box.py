"""Push a box along the floor with an arm of two links, read from an MJCF file.

It resembles tabletop pushes that come with simulators. The arm hangs in front of its post with the tip above and short
of the box, which is on a rail. The tip must come down behind the box and push it 0.25 m forward. Leaving the box costs
100 x 0.0625, which is 6.25. The best-known value is plausible since the box's path is straight and the arm's swing
down to it short; pushes and hits are both among the samples, and cost more.
"""

from pathlib import Path

import casadi as ca
import numpy as np

from ocp import Problem, Scaling
from problems import robots
from problems.parameters import Parameters, quantity, structure, table

name = "arm-box"
title = "An arm of a file pushes a box"
axes = ("", "")
robot = robots.load(Path(__file__).parent / "arm_box.xml")
START = np.array([0.2, 1.9, 0.0])  # shoulder, elbow [rad], box [m]


class Params(Parameters):
    """Parameters are of the box's push; the robot is in its file."""

    goal: float = quantity(0.25, "m", "how far to push")
    effort: float = quantity(0.01, "1", "weight of the inputs", least=0)
    h: float = quantity(0.04, "s", "step size", above=0)
    N: int = structure(40, "number of steps", least=1)


def build(params: Params) -> Problem:
    """Build the problem; states are shoulder, elbow, box and velocities, inputs shares of the largest torques."""
    p = table(params)
    system = robot.machine.system(name, p, h=p["h"], friction=robot.coefficients)
    lower, upper = robot.controls.T
    x, nq = system.x, len(START)
    return Problem(
        name,
        system,
        params.N,
        stage_cost=p["effort"] * ca.sumsqr(system.u),
        terminal_cost=100 * (x[2] - p["goal"]) ** 2 + 0.1 * ca.sumsqr(x[nq:]),
        parameters=p,
        x0=ca.vertcat(ca.SX(START), ca.SX.zeros(nq)),
        u_lower=lower,
        u_upper=upper,
        scaling=Scaling(impulse=0.2, gap=0.1),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the box is within 4 cm of its goal."""
    return abs(state[2] - params.goal) < 0.04


def draw(params: Params, state: np.ndarray):
    """Return the shapes of the arm and the box at one state."""
    return robot.shapes(state)
