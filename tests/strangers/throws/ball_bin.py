"""Throw a ball over the wall of a bin, so that it lies in the bin at the end.

It resembles throwing tasks for a planar hand. The ball lies on a flat hand that a force moves in the plane, held by
friction only, and the bin's wall is in between. The hand may not go beyond x = 0.5, so that the ball must fly the rest.
The best-known value is plausible since the flight's height over the wall fixes the speed of release, and the hand's
work is that of accelerating the ball and itself to this speed.
"""

import casadi as ca
import numpy as np

from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table
from problems.scenes import Body, Box, Capsule, Disc, Goal, HalfPlane, Obstacle, Pusher, Scene, drawing_functions

name = "ball-bin"
title = "A ball thrown into a bin"


class Params(Parameters):
    """The bin's wall is at x = 0.8 and its centre at x = 1.1."""

    ball: float = quantity(0.2, "kg", "mass of the ball", above=0)
    hand: float = quantity(0.3, "kg", "mass of the hand", above=0)
    wall: float = quantity(0.5, "m", "height of the bin's wall", above=0)
    bin: float = quantity(1.1, "m", "middle of the bin")
    friction: float = quantity(0.8, "1", "Coulomb's coefficient", least=0)
    force: float = quantity(15.0, "N", "largest force on the hand", above=0)
    h: float = quantity(0.03, "s", "step size", above=0)
    N: int = structure(40, "number of steps", least=1)


def scene(p):
    """Return hand, ball, the bin's wall and the floor."""
    return Scene(
        [
            Pusher("hand", Box((0.1, 0.02)), at=(0.0, 0.3), mass=p["hand"]),
            Body("ball", Disc(0.04), at=(0.0, 0.36), mass=p["ball"]),
            Obstacle("wall", Capsule((0.8, 0.0), (0.8, p["wall"]), 0.02), at=(0.0, 0.0)),
            Obstacle("floor", HalfPlane(), at=(0.0, 0.0)),
            Goal("ball", at=(p["bin"], 0.04)),
        ],
        friction=p["friction"],
        non_colliding=[("hand", "floor"), ("hand", "wall")],
    )


draw, frames = drawing_functions(scene)


def build(params: Params) -> Problem:
    """Build the problem; the input is the force on the hand."""
    p = table(params)
    things = scene(p)
    system = things.time_stepping(name, p, h=p["h"], gravity=(0.0, -9.81))
    x, u = system.x, system.u
    off = things.coordinates_of("ball", x) - ca.vertcat(p["bin"], 0.04)
    weight = ca.vertcat(0, (p["ball"] + p["hand"]) * 9.81)
    beyond = ca.vertcat(-ca.inf, -ca.inf, -ca.inf, -ca.inf)
    return Problem(
        name,
        system,
        params.N,
        stage_cost=1e-3 * ca.sumsqr(u - weight) / 10,
        terminal_cost=20 * ca.sumsqr(off) + 0.1 * ca.sumsqr(x[4:6]),
        x0=things.at_rest(system),
        parameters=p,
        u_lower=-p["force"],
        u_upper=p["force"],
        x_lower=ca.vertcat(beyond, beyond),
        x_upper=ca.vertcat(ca.inf, ca.inf, 0.5, ca.inf, -beyond),
        scaling=Scaling(impulse=0.2, gap=0.1, x=0.3, u=5),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the ball lies in the bin."""
    return bool(abs(state[0] - params.bin) < 0.2 and state[1] < 0.15)
