"""Stand a box up against a wall with one fingertip.

It resembles planar pivoting with extrinsic contact: finger, floor and wall, friction 0.6 everywhere, a free box of
half a kilogram with all its corners. Lying still costs more than 10. The best-known value is plausible since barrier
plans made exact end near 0.042, and sampling from any start does not get below.
"""

import casadi as ca
import numpy as np

from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table
from problems.scenes import Body, Box, Disc, Goal, HalfPlane, Obstacle, Pusher, Scene, drawing_functions

name = "pivot-box"
title = "A box stood up against a wall"
UPRIGHT = (0.2, 0.15, -np.pi / 2)  # pose of the box at the wall [m, m, rad]


class Params(Parameters):
    """The box is 0.3 m by 0.1 m; the wall is at x = 0.25."""

    friction: float = quantity(0.6, "1", "Coulomb's coefficient of all contacts", least=0)
    box_x: float = quantity(0.0, "m", "middle of the box at the start")
    mass: float = quantity(0.5, "kg", "mass of the box", above=0)
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(30, "number of steps", least=1)


def scene(p):
    """Return finger, box, floor and wall; the finger passes through floor and wall."""
    box = Body("box", Box((0.15, 0.05)), at=(p["box_x"], 0.05), mass=p["mass"], inertia=p["mass"] * 0.1 / 12)
    return Scene(
        [
            Pusher("finger", Disc(0.02), at=(p["box_x"] - 0.25, 0.06), mass=0.3),
            box,
            Obstacle("floor", HalfPlane(), at=(0.0, 0.0)),
            Obstacle("wall", HalfPlane(normal=(-1.0, 0.0)), at=(0.25, 0.0)),
            Goal("box", at=UPRIGHT[:2], angle=UPRIGHT[2]),
        ],
        friction=p["friction"],
        non_colliding=[("finger", "floor"), ("finger", "wall")],
    )


draw, frames = drawing_functions(scene)


def build(params: Params) -> Problem:
    """Build the problem; the input is the force on the finger, which must also carry the finger's weight."""
    p = table(params)
    things = scene(p)
    system = things.time_stepping(name, p, h=p["h"], gravity=(0.0, -9.81))
    off = (things.coordinates_of("box", system.x) - ca.DM(UPRIGHT)) * ca.DM([1, 1, 0.15])
    return Problem(
        name,
        system,
        params.N,
        stage_cost=1e-4 * ca.sumsqr(system.u) + 0.01 * ca.sumsqr(off),
        terminal_cost=100 * ca.sumsqr(off) + 0.1 * ca.sumsqr(system.x[5:]),
        x0=things.at_rest(system),
        parameters=p,
        u_lower=-20,
        u_upper=20,
        scaling=Scaling(impulse=0.3, gap=0.1, x=0.3, u=5),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the box is upright at the wall."""
    return bool(abs(state[2] - UPRIGHT[2]) < 0.2 and abs(state[0] - UPRIGHT[0]) < 0.05)
