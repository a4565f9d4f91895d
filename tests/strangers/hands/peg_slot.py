"""Slide a peg into a slot by compliance.

It resembles peg-in-hole by remote-centre compliance: the round peg is held by a spring of the hand, and two blocks
with round corners leave a slot half a millimetre wider than it. The hand is too far left, above a block's flat top, so
that straight down only presses on it. It must go aside first, and let the corner lead the peg in. The best-known value
is plausible since the command's shortest path aside and down consists of straight lines round one corner.
"""

import casadi as ca
import numpy as np

from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table
from problems.scenes import Box, Disc, Obstacle, Pusher, Scene, drawing_functions

name = "peg-slot"
title = "A peg slides into a slot"


class Params(Parameters):
    """The slot's centre is at x = 0, the tops of the blocks at y = 0."""

    radius: float = quantity(0.01, "m", "radius of the peg", above=0)
    slack: float = quantity(0.0005, "m", "by which the slot is wider than the peg", above=0)
    deep: float = quantity(0.02, "m", "how deep its middle must go", above=0)
    aside: float = quantity(-0.02, "m", "where the hand starts, beside the slot's middle")
    friction: float = quantity(0.3, "1", "Coulomb's coefficient", least=0)
    stiffness: float = quantity(400.0, "N/m", "of the hand's spring", above=0)
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(30, "number of steps", least=1)


def scene(p):
    """Return the peg on its hand and the two blocks next to the slot."""
    middle = p["radius"] + p["slack"] / 2 + 0.03
    block = Box((0.025, 0.025), radius=0.005)
    return Scene(
        [
            Pusher("peg", Disc(p["radius"]), at=(p["aside"], 0.03), stiffness=p["stiffness"]),
            Obstacle("left", block, at=(-middle, -0.03)),
            Obstacle("right", block, at=(middle, -0.03)),
        ],
        friction=p["friction"],
    )


draw, frames = drawing_functions(scene)


def build(params: Params) -> Problem:
    """Build the problem; the input is the hand's commanded position, and its changes are the effort."""
    p = table(params)
    things = scene(p)
    system = things.quasi_dynamic(name, p, h=p["h"])
    off = things.coordinates_of("peg", system.x) - ca.vertcat(0, -p["deep"])
    du = ca.SX.sym("du", 2)
    return Problem(
        name,
        system,
        params.N,
        stage_cost=10 * ca.sumsqr(off) + 200 * ca.sumsqr(du),
        terminal_cost=2000 * ca.sumsqr(off),
        x0=things.at_rest(system),
        parameters=p,
        du=du,
        u_before=things.hold,
        scaling=Scaling(impulse=0.2, gap=0.01, x=0.02, u=0.02),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the peg is in the slot to within three millimetres."""
    return bool(np.hypot(state[0], state[1] + params.deep) < 0.003)
