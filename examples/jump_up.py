"""A robot that is read from a URDF or MJCF file jumps: at the end its feet are off the ground, as when it stands."""

from pathlib import Path

import casadi as ca
import numpy as np

from ocp import Problem
from problems import robots
from problems.drawing import ContactFrame, Shape
from problems.machines.footfalls import footfall_cost
from problems.parameters import quantity, structure
from problems.robots.motions import LegParams, RobotMotion

name = "jump-up"
title = "A robot of a file jumps"
axes = ("", "")  # a picture in perspective has no rulers
robot = robots.load(Path(__file__).parent / "hopper.xml")  # what it has: ocp show FILE
stands = robot.standing()  # the file's home, lowered to the ground


class Params(LegParams):
    """Further numbers: friction, weights of inputs, velocities and sliding feet, h and N."""

    rise: float = quantity(0.05, "m", "height of the feet above the ground at the end", least=0)
    w_pose: float = quantity(1000.0, "1", "terminal weight of the distance from the standing pose, raised", least=0)
    w_rest: float = quantity(0.1, "s^2", "terminal weight of the velocities", least=0)
    N: int = structure(24, "number of steps", least=1)


def build(params: Params) -> Problem:
    """The state is q, whose names ocp show lists, then the velocities."""
    motion = RobotMotion.of(name, params, robot)
    p, q, v = motion.p, motion.q, motion.v
    return motion.problem(
        stands,
        stage_cost=motion.effort + footfall_cost(params, p, motion.system),
        terminal_cost=p["w_pose"] * ca.sumsqr(q - robot.raised(stands, p["rise"])) + p["w_rest"] * ca.sumsqr(v),
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """The robot at one state, for pages and animations."""
    return robot.shapes(state)


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Place and normal of every contact, for the arrows of its force."""
    return robot.frames(state, params.friction)
