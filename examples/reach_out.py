"""The end effector of a robot that is read from a URDF or MJCF file goes to a point."""

from pathlib import Path

import casadi as ca
import numpy as np

from ocp import Problem
from problems import robots
from problems.drawing import ContactFrame, Shape
from problems.parameters import quantity
from problems.robots.motions import MotionParams, RobotMotion
from problems.robots.poses import end_effector, reachable

name = "reach-out"
title = "A robot of a file reaches a point"
axes = ("", "")  # a picture in perspective has no rulers
robot = robots.load(Path(__file__).parent / "arm.xml")  # what it has: ocp show FILE
tip = end_effector(robot)  # a body and a point in its frame: BodyPlace("fore", (0, 0, -0.25))
x, y, z = reachable(robot)  # where it is with every joint turned, nothing touching


class Params(MotionParams):
    """Further numbers: friction, weights of inputs and velocities, h and N."""

    x: float = quantity(x, "m", "goal of the end effector along x")
    y: float = quantity(y, "m", "goal of the end effector along y")
    z: float = quantity(z, "m", "goal of the end effector along z")
    w_goal: float = quantity(1e3, "1/m^2", "terminal weight of the distance from the goal", least=0)
    w_rest: float = quantity(1.0, "s^2", "terminal weight of the velocities", least=0)


def build(params: Params) -> Problem:
    """The state is q, whose names ocp show lists, then the velocities."""
    motion = RobotMotion.of(name, params, robot)
    p = motion.p
    distance = tip.position(robot.machine, motion.q) - ca.vertcat(p["x"], p["y"], p["z"])
    return motion.problem(
        robot.home,
        stage_cost=motion.effort,
        terminal_cost=p["w_goal"] * ca.sumsqr(distance) + p["w_rest"] * ca.sumsqr(motion.v),
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """The robot at one state, for pages and animations."""
    return robot.shapes(state)


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Place and normal of every contact, for the arrows of its force."""
    return robot.frames(state, params.friction)
