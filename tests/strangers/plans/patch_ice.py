"""Push a block from dry floor onto ice, and let it come to rest on a mark there.

The surfaces differ in friction: 0.6 up to x = 1, and 0.05 beyond, with the mark at x = 2. The best-known value,
2.03867, is also that of a program without this library, which enumerates the step at which the block crosses over.
"""

import casadi as ca
import numpy as np

from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table
from problems.scenes import Body, Box, Disc, Goal, Obstacle, Pusher, Scene, drawing_functions

name = "patch-ice"
title = "A block from floor to ice"


class Params(Parameters):
    """Hand and block are on one line; both floors are the flat tops of boxes."""

    floor: float = quantity(0.6, "1", "Coulomb's coefficient of the dry floor", least=0)
    ice: float = quantity(0.05, "1", "Coulomb's coefficient of the ice", least=0)
    mark: float = quantity(2.0, "m", "where to rest")
    force: float = quantity(15.0, "N", "largest force of the hand", above=0)
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(40, "number of steps", least=2)


def scene(p):
    """Return the light hand, the block of 1 kg, and the two floors that meet at x = 1."""
    slab = Box((2.0, 0.5))
    return Scene(
        [
            Pusher("hand", Disc(0.1), at=(-0.2, 0.1), mass=0.01, axis=(1.0, 0.0)),
            Body("block", Disc(0.1), at=(0.0, 0.1), mass=1.0),
            Obstacle("floor", slab, at=(-1.0, -0.5)),
            Obstacle("ice", slab, at=(3.0, -0.5)),
            Goal("block", at=(p["mark"], 0.1)),
        ],
        friction={("block", "floor"): p["floor"], ("block", "ice"): p["ice"]},
        non_colliding=[("hand", "floor"), ("hand", "ice")],
    )


draw, frames = drawing_functions(scene)


def build(params: Params) -> Problem:
    """Build the problem; the input is the hand's force."""
    p = table(params)
    things = scene(p)
    system = things.time_stepping(name, p, h=p["h"], gravity=(0.0, -9.81))
    off = things.coordinates_of("block", system.x)[0] - p["mark"]
    speeds = system.x[3:]
    return Problem(
        name,
        system,
        params.N,
        stage_cost=0.01 * p["h"] * system.u**2,
        terminal_cost=100 * off**2 + 10 * ca.sumsqr(speeds),
        x0=things.at_rest(system),
        parameters=p,
        u_lower=-p["force"],
        u_upper=p["force"],
        scaling=Scaling(impulse=0.3, gap=0.1, u=5),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the block is within 15 cm of its mark."""
    return abs(state[0] - params.mark) < 0.15
