"""A robot that is read from a URDF or MJCF file walks: a stride that repeats, at a given speed."""

from pathlib import Path

import casadi as ca
import numpy as np

from ocp import Problem
from problems import robots
from problems.drawing import ContactFrame, Shape
from problems.machines.footfalls import footfall_cost
from problems.parameters import quantity, structure
from problems.robots.motions import LegParams, RobotMotion

name = "walk-on"
title = "A robot of a file walks"
axes = ("", "")  # a picture in perspective has no rulers
robot = robots.load(Path(__file__).parent / "hopper.xml")  # what it has: ocp show FILE
stands = robot.standing()  # the file's home, lowered to the ground


class Params(LegParams):
    """Further numbers: friction, weights of inputs, velocities and sliding feet, h and N."""

    speed: float = quantity(0.3, "m/s", "mean speed of the stride along x")
    w_pose: float = quantity(0.5, "1/s", "weight of the distance from the standing pose", least=0)
    N: int = structure(24, "number of steps of a stride", least=2)


def build(params: Params) -> Problem:
    """The state is q, whose names ocp show lists, then the velocities."""
    motion = RobotMotion.of(name, params, robot)
    p = motion.p
    posture = p["h"] * p["w_pose"] * ca.sumsqr(motion.posture(stands))
    footfalls = footfall_cost(params, p, motion.system)  # feet that slide or are not lifted
    return motion.stride(stands, p["speed"], stage_cost=motion.effort + footfalls + posture)


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """The robot at one state, for pages and animations."""
    return robot.shapes(state)


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Place and normal of every contact, for the arrows of its force."""
    return robot.frames(state, params.friction)
