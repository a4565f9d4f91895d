"""Hit a puck with a bat from behind, so that it is at its mark at the last step.

It resembles air hockey: no friction on the table, one shot. The bat starts in front of the puck, on the side of the
mark, must go round it, and may not follow it beyond x = 0.15. The puck must be hit, with a speed and a direction that
both decide where it ends. The best-known value is plausible since one hit suffices, whose position, time and direction
are three numbers that sampling covers, and the relaxations end at the same hit.
"""

import casadi as ca
import numpy as np

from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table
from problems.scenes import Body, Disc, Goal, Pusher, Scene, drawing_functions

name = "puck-bat"
title = "A bat hits a puck"


class Params(Parameters):
    """The puck starts at the origin, the bat to its upper right."""

    puck: float = quantity(0.15, "kg", "mass of the puck", above=0)
    bat: float = quantity(0.5, "kg", "mass of the bat", above=0)
    mark_x: float = quantity(1.0, "m", "mark, x")
    mark_y: float = quantity(0.3, "m", "mark, y")
    friction: float = quantity(0.2, "1", "Coulomb's coefficient of bat on puck", least=0)
    force: float = quantity(5.0, "N", "largest force on the bat, along either axis", above=0)
    h: float = quantity(0.04, "s", "step size", above=0)
    N: int = structure(40, "number of steps", least=1)


def scene(p):
    """Return the puck, the bat and the mark."""
    return Scene(
        [
            Pusher("bat", Disc(0.05), at=(0.12, 0.05), mass=p["bat"]),
            Body("puck", Disc(0.03), at=(0.0, 0.0), mass=p["puck"]),
            Goal("puck", at=(p["mark_x"], p["mark_y"])),
        ],
        friction=p["friction"],
    )


draw, frames = drawing_functions(scene)


def build(params: Params) -> Problem:
    """Build the problem; the input is the force on the bat, and at the end only the puck's position counts."""
    p = table(params)
    things = scene(p)
    system = things.time_stepping(name, p, h=p["h"])
    x = system.x
    off = things.coordinates_of("puck", x) - ca.vertcat(p["mark_x"], p["mark_y"])
    free = ca.DM([ca.inf] * 8)
    upper = ca.DM([ca.inf, ca.inf, 0.15, ca.inf, ca.inf, ca.inf, ca.inf, ca.inf])
    return Problem(
        name,
        system,
        params.N,
        stage_cost=1e-3 * ca.sumsqr(system.u),
        terminal_cost=20 * ca.sumsqr(off),
        x0=things.at_rest(system),
        parameters=p,
        u_lower=-p["force"],
        u_upper=p["force"],
        x_lower=-free,
        x_upper=upper,
        scaling=Scaling(impulse=0.2, gap=0.05, x=0.3, u=2),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the puck is at its mark."""
    return bool(np.hypot(state[0] - params.mark_x, state[1] - params.mark_y) < 0.08)
