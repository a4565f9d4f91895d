"""A robot that is read from a URDF or MJCF file stands up from a crouch."""

from pathlib import Path

import casadi as ca
import numpy as np

from ocp import Problem
from problems import robots
from problems.drawing import ContactFrame, Shape
from problems.machines.footfalls import footfall_cost
from problems.parameters import quantity
from problems.robots.motions import LegParams, RobotMotion
from problems.robots.poses import crouched

name = "stand-up"
title = "A robot of a file stands up"
axes = ("", "")  # a picture in perspective has no rulers
robot = robots.load(Path(__file__).parent / "hopper.xml")  # what it has: ocp show FILE
stands = robot.standing()  # the file's home, lowered to the ground
start = crouched(robot, 0.1)  # the trunk lower by a tenth of its height, feet where they are


class Params(LegParams):
    """Further numbers: friction, weights of inputs, velocities and sliding feet, h and N."""

    w_pose: float = quantity(100.0, "1", "terminal weight of the distance from the standing pose", least=0)
    w_rest: float = quantity(1.0, "s^2", "terminal weight of the velocities", least=0)


def build(params: Params) -> Problem:
    """The state is q, whose names ocp show lists, then the velocities."""
    motion = RobotMotion.of(name, params, robot)
    p, q, v = motion.p, motion.q, motion.v
    return motion.problem(
        start,
        stage_cost=motion.effort + footfall_cost(params, p, motion.system),
        terminal_cost=p["w_pose"] * ca.sumsqr(q - stands) + p["w_rest"] * ca.sumsqr(v),
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """The robot at one state, for pages and animations."""
    return robot.shapes(state)


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Place and normal of every contact, for the arrows of its force."""
    return robot.frames(state, params.friction)
