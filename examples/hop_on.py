"""A robot that is read from a URDF or MJCF file goes on, or to another pose of its joints."""

from pathlib import Path

import casadi as ca
import numpy as np

from ocp import Problem, Scaling
from problems import robots
from problems.drawing import ContactFrame, Shape
from problems.parameters import Parameters, quantity, structure, table

name = "hop-on"
title = "A robot of a file goes to another pose"
axes = ("", "")  # a picture in perspective has no rulers
robot = robots.load(Path(__file__).parent / "hopper.xml")  # what it has: ocp show FILE
start = robot.standing()  # the file's home; a robot that floats stands on the ground
nq = len(start)


class Params(Parameters):
    """All numbers: value, unit, meaning, range. Set one with -p NAME=VALUE."""

    distance: float = quantity(0.2, "m", "way along x; of every joint, where the root is fixed")
    friction: float = quantity(1.0, "1", "factor on the file's coefficients of friction", above=0)
    w_u: float = quantity(0.1, "1/s", "weight of the inputs", least=0)
    w_v: float = quantity(0.01, "s", "weight of the velocities, against swinging", least=0)
    h: float = quantity(0.025, "s", "step size", above=0)
    N: int = structure(40, "number of steps", least=1)  # shapes the problem, is no symbol


def build(params: Params) -> Problem:
    """The state is q, whose names ocp show lists, then the velocities."""
    p = table(params)  # a symbol for each quantity
    machine, goal = robot.machine, robot.displaced(start, p["distance"])
    system = machine.system(name, p, h=p["h"], friction=p["friction"] * robot.coefficients)
    lower, upper = robot.controls.T  # limits of the inputs: units of gear, or positions of servos
    size = np.where(np.isfinite(upper - lower), (upper - lower) / 2, 1.0)
    share = (system.u - robot.holding_inputs(start)) / size
    q, v = system.x[:nq], system.x[nq:]
    running = p["w_u"] * ca.sumsqr(share) + p["w_v"] * ca.sumsqr(v)
    return Problem(
        name,
        system,
        params.N,
        stage_cost=p["h"] * running,
        terminal_cost=100 * ca.sumsqr(q - goal) + ca.sumsqr(v),
        parameters=p,
        x0=ca.vertcat(ca.SX(start), ca.SX.zeros(v.numel())),
        u_lower=lower,
        u_upper=upper,
        scaling=Scaling(impulse=0.25 * robot.mass, gap=0.1),  # of a contact: g h m, and 0.1 m
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """The robot at one state, for pages and animations."""
    return robot.shapes(state)


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Place and normal of every contact, for the arrows of its force."""
    return robot.frames(state, params.friction)
