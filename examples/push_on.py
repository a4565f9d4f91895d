"""A robot that is read from a URDF or MJCF file pushes an object of that file."""

from pathlib import Path

import casadi as ca
import numpy as np

from ocp import Problem
from problems import robots
from problems.drawing import ContactFrame, Shape
from problems.parameters import quantity
from problems.robots.motions import MotionParams, RobotMotion
from problems.robots.poses import BodyPlace, push_direction, pushed_object

name = "push-on"
title = "A robot of a file pushes an object"
axes = ("", "")  # a picture in perspective has no rulers
robot = robots.load(Path(__file__).parent / "arm.xml")  # what it has: ocp show FILE
box = BodyPlace(pushed_object(robot))  # a body without motors that the robot may touch
direction = push_direction(robot, box.body)  # horizontal, away from the end effector


class Params(MotionParams):
    """Further numbers: friction, weights of inputs and velocities, h and N."""

    distance: float = quantity(0.1, "m", "how far to push the object")
    w_goal: float = quantity(1e3, "1/m^2", "terminal weight of the distance from the goal", least=0)
    w_rest: float = quantity(1.0, "s^2", "terminal weight of the velocities", least=0)


def build(params: Params) -> Problem:
    """The state is q, whose names ocp show lists, then the velocities."""
    motion = RobotMotion.of(name, params, robot)
    p, machine = motion.p, robot.machine
    goal = box.at(machine, robot.home) + p["distance"] * direction
    error = box.position(machine, motion.q) - goal
    return motion.problem(
        robot.home,
        stage_cost=motion.effort,
        terminal_cost=p["w_goal"] * ca.sumsqr(error) + p["w_rest"] * ca.sumsqr(motion.v),
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """The robot at one state, for pages and animations."""
    return robot.shapes(state)


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Place and normal of every contact, for the arrows of its force."""
    return robot.frames(state, params.friction)
