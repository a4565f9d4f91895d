"""Drive a nail that friction holds against any push of the hammer's weak motor.

It resembles impact tasks in trajectory optimisation. Friction holds the nail with four times its weight, 39.2 N; the
motor gives 10 N and the hammer starts 5 cm in front of the nail. Only momentum moves the nail. Not moving it costs 4.
The best-known value is plausible since others compared a hand-written complementarity program, sampling, and other
relaxations, and a solve on the contact branch of the best sample is below all of them.
"""

import casadi as ca
import numpy as np

from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table
from problems.scenes import Body, Disc, Goal, HalfPlane, Obstacle, Pusher, Scene, drawing_functions

name = "hammer"
title = "A nail is hammered in"


class Params(Parameters):
    """Hammer and nail are on one line along x; both are round with a radius of 0.1 m."""

    goal: float = quantity(0.02, "m", "how deep the nail is wanted")
    strength: float = quantity(10.0, "N", "largest force of the motor", above=0)
    friction: float = quantity(4.0, "1", "Coulomb's coefficient of nail and rail", above=0)
    h: float = quantity(0.02, "s", "step size", above=0)
    N: int = structure(40, "number of steps", least=2)


def scene(p):
    """Return the hammer of 2 kg and the nail of 1 kg, which is on a rail."""
    hammer = Pusher("hammer", Disc(0.1), at=(-0.25, 0.1), mass=2.0, axis=(1.0, 0.0))
    nail = Body("nail", Disc(0.1), at=(0.0, 0.1), mass=1.0)
    rail = Obstacle("rail", HalfPlane(), at=(0.0, 0.0))
    return Scene(
        [hammer, nail, rail, Goal("nail", at=(p["goal"], 0.1))],
        friction={("nail", "rail"): p["friction"]},
        non_colliding=[("hammer", "rail")],
    )


draw, frames = drawing_functions(scene)


def build(params: Params) -> Problem:
    """Build the problem; the input is the motor's force."""
    p = table(params)
    things = scene(p)
    system = things.time_stepping(name, p, h=p["h"], gravity=(0, -9.81))
    short = things.coordinates_of("nail", system.x)[0] - p["goal"]
    return Problem(
        name,
        system,
        params.N,
        stage_cost=0.001 * p["h"] * ca.sumsqr(system.u),
        terminal_cost=10_000 * short**2,
        x0=things.at_rest(system),
        parameters=p,
        u_lower=-p["strength"],
        u_upper=p["strength"],
        scaling=Scaling(impulse=0.5, gap=0.05, x=0.1, u=5),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the nail is within 4 mm of its depth."""
    return abs(state[0] - params.goal) < 0.004
