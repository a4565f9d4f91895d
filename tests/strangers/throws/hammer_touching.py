"""Drive a nail with a hammer that starts on the nail's head.

It resembles impact tasks: the hammer's motor gives 8 N, while friction holds the nail with 29 N. Pushing never moves
it. The hammer must first be drawn back, against every local improvement, and then hit, perhaps more than once. An
unmoved nail costs 1.8. The best-known value is plausible since one blow from the farthest distance is the cheapest;
a plain relaxation and sampling end within a tenth of each other.
"""

import casadi as ca
import numpy as np

from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table
from problems.scenes import Body, Disc, Goal, HalfPlane, Obstacle, Pusher, Scene, drawing_functions

name = "hammer-touching"
title = "A hammer that touches the nail already"


class Params(Parameters):
    """The nail's weight of 9.8 N presses it onto its guide."""

    deep: float = quantity(0.03, "m", "how deep to drive the nail", above=0)
    hammer: float = quantity(1.5, "kg", "mass of the hammer", above=0)
    nail: float = quantity(1.0, "kg", "mass of the nail", above=0)
    hold: float = quantity(3.0, "1", "Coulomb's coefficient of the nail in its guide", above=0)
    force: float = quantity(8.0, "N", "largest force on the hammer", above=0)
    h: float = quantity(0.02, "s", "step size", above=0)
    N: int = structure(50, "number of steps", least=1)


def scene(p):
    """Return the hammer on its rail, the nail on its guide, and the nail's goal."""
    return Scene(
        [
            Pusher("hammer", Disc(0.1), at=(-0.15, 0.05), mass=p["hammer"], axis=(1.0, 0.0)),
            Body("nail", Disc(0.05), at=(0.0, 0.05), mass=p["nail"]),
            Obstacle("guide", HalfPlane(), at=(0.0, 0.0)),
            Goal("nail", at=(p["deep"], 0.05)),
        ],
        friction={("nail", "guide"): p["hold"]},
        non_colliding=[("hammer", "guide")],
    )


draw, frames = drawing_functions(scene)


def build(params: Params) -> Problem:
    """Build the problem; the input is the force on the hammer, along its rail."""
    p = table(params)
    things = scene(p)
    system = things.time_stepping(name, p, h=p["h"], gravity=(0.0, -9.81))
    off = things.coordinates_of("nail", system.x)[0] - p["deep"]
    return Problem(
        name,
        system,
        params.N,
        stage_cost=2e-5 * system.u**2,
        terminal_cost=2000 * off**2 + 0.01 * ca.sumsqr(system.x[3:]),
        x0=things.at_rest(system),
        parameters=p,
        u_lower=-p["force"],
        u_upper=p["force"],
        scaling=Scaling(impulse=0.5, gap=0.05, x=0.1, u=4),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the nail is in by at least two thirds."""
    return state[0] > params.deep * 2 / 3
