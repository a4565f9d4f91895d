"""Drive a ball through a maze of three walls in the plane.

It is trajectory optimisation among obstacles, here with walls that may be touched: the straight path to the exit is
blocked twice. A ball pressed against the first wall is a local optimum. Staying costs 10 x 1.44. The best-known value
is plausible since the shortest path through the two gaps is unique, and smooth driving along it is a convex program
once the side of each wall is chosen; the other sides are closed or longer.
"""

import casadi as ca
import numpy as np

from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table
from problems.scenes import Box, Disc, Obstacle, Pusher, Scene, drawing_functions

name = "walls-maze"
title = "A ball in a maze of walls"


class Params(Parameters):
    """The ball starts at the origin; the exit is to the right, behind walls from below and above and a block."""

    ball: float = quantity(0.3, "kg", "mass of the ball", above=0)
    radius: float = quantity(0.05, "m", "radius of the ball", above=0)
    goal_x: float = quantity(1.2, "m", "exit, x")
    force: float = quantity(4.0, "N", "largest force along either axis", above=0)
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(45, "number of steps", least=1)


def scene(p):
    """Return the ball and three smooth walls."""
    return Scene(
        [
            Pusher("ball", Disc(p["radius"]), at=(0.0, 0.0), mass=p["ball"]),
            Obstacle("low", Box((0.03, 0.5)), at=(0.35, -0.3)),
            Obstacle("high", Box((0.03, 0.5)), at=(0.75, 0.35)),
            Obstacle("block", Box((0.06, 0.1)), at=(1.0, -0.1)),
        ]
    )


draw, frames = drawing_functions(scene)


def build(params: Params) -> Problem:
    """Build the problem; the input is the force on the ball."""
    p = table(params)
    things = scene(p)
    system = things.time_stepping(name, p, h=p["h"])
    x = system.x
    off = x[:2] - ca.vertcat(p["goal_x"], 0)
    return Problem(
        name,
        system,
        params.N,
        stage_cost=2e-3 * ca.sumsqr(system.u),
        terminal_cost=10 * ca.sumsqr(off) + ca.sumsqr(x[2:]),
        x0=things.at_rest(system),
        parameters=p,
        u_lower=-p["force"],
        u_upper=p["force"],
        scaling=Scaling(impulse=0.2, gap=0.1, x=0.5, u=2),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the ball is at the exit."""
    return bool(np.hypot(state[0] - params.goal_x, state[1]) < 0.1)
