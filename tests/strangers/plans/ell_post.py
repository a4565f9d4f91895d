"""Push an L-shaped block past a post and turn it by a quarter.

It resembles planar pushing with limit surfaces: a round finger on a spring, an L of 1 kg on a table of friction 0.4,
with a post in between. Leaving it costs more than 20 x 0.37. The best-known value is probably only an upper bound:
an L has many contact sequences, and the best of the push search and of every route is kept.
"""

import casadi as ca
import numpy as np

from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table
from problems.scenes import Body, Disc, Goal, Obstacle, Polygon, Pusher, Scene, Union, drawing_functions

name = "ell-post"
title = "An L pushed past a post"
FOOT = Polygon([(-0.15, -0.1), (0.15, -0.1), (0.15, 0.0), (-0.15, 0.0)])
LIMB = Polygon([(-0.15, 0.0), (-0.05, 0.0), (-0.05, 0.15), (-0.15, 0.15)])


class Params(Parameters):
    """The L starts at the origin, with its foot along x."""

    post: float = quantity(0.06, "m", "radius of the post", above=0)
    friction: float = quantity(0.3, "1", "Coulomb's coefficient of finger and L", least=0)
    x: float = quantity(0.5, "m", "goal of the L, x")
    y: float = quantity(0.15, "m", "goal of the L, y")
    turn: float = quantity(1.5708, "rad", "goal of the L, angle")
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(16, "number of steps", least=1)


def scene(p):
    """Return finger, L and post on the table."""
    return Scene(
        [
            Pusher("finger", Disc(0.03), at=(-0.3, 0.0), stiffness=200.0),
            Body("ell", Union([FOOT, LIMB]), at=(0.0, 0.0), mass=1.0, inertia=0.02, table=0.4),
            Obstacle("post", Disc(p["post"]), at=(0.32, -0.02)),
            Goal("ell", at=(p["x"], p["y"]), angle=p["turn"]),
        ],
        friction={("finger", "ell"): p["friction"]},
    )


draw, frames = drawing_functions(scene)


def build(params: Params) -> Problem:
    """Build the problem; the input is the finger's commanded position, and its changes are the effort."""
    p = table(params)
    things = scene(p)
    system = things.quasi_dynamic(name, p, h=p["h"])
    off = (things.coordinates_of("ell", system.x) - ca.vertcat(p["x"], p["y"], p["turn"])) * ca.DM([1, 1, 0.2])
    du = ca.SX.sym("du", system.nu)
    return Problem(
        name,
        system,
        params.N,
        stage_cost=0.01 * ca.sumsqr(off) + 0.05 * ca.sumsqr(du),
        terminal_cost=20 * ca.sumsqr(off),
        x0=things.at_rest(system),
        parameters=p,
        du=du,
        u_before=things.hold,
        scaling=Scaling(impulse=0.3, gap=0.1, x=0.5, u=0.5),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the L is near its goal pose."""
    return bool(np.hypot(state[0] - params.x, state[1] - params.y) < 0.1 and abs(state[2] - params.turn) < 0.5)
