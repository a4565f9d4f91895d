"""Bring a mass to rest at a wall in minimum time; the wall may stop it.

It resembles minimum-time exercises with a free final time. The best-known value has a closed form: full force until
the wall stops the mass in the last step but one, (N - 1) N / 2 h^2 F / m = d, so that
T = N h = sqrt(2 d N m / (F (N - 1))), which is 1.0259784 s here.
"""

import casadi as ca
import numpy as np

from dynamics.systems import signals, time_stepping
from ocp import Constraint, Problem, Scaling, free
from problems.parameters import Parameters, quantity, structure, table

name = "wall-least-time"
title = "A mass rests at a wall as soon as it can"


class Params(Parameters):
    """The mass starts at rest, one metre before the wall."""

    mass: float = quantity(2.0, "kg", "mass", above=0)
    force: float = quantity(4.0, "N", "largest force, either way", above=0)
    way: float = quantity(1.0, "m", "way to the wall", above=0)
    h: float = quantity(0.05, "s", "first guess of the step size", above=0)
    N: int = structure(20, "number of steps", least=2)


def build(params: Params) -> Problem:
    """Build the problem; the state is position, speed, and the step size, which is optimised too."""
    p = table(params)
    system = time_stepping(
        name,
        states=signals("x [m]; v [m/s]"),
        inputs=signals("f [N]"),
        contacts=signals("wall [N s]"),
        h=p["h"],
        mass=p["mass"],
        impulse=lambda q, v, u: p["h"] * u,
        distance=lambda q: p["way"] - q,
        parameters=p,
    )
    x, v = system.x[0], system.x[1]
    return Problem(
        name,
        system,
        params.N,
        stage_cost=0,
        terminal_cost=params.N * p["h"],
        x0=ca.DM([0, 0]),
        parameters=p,
        u_lower=-p["force"],
        u_upper=p["force"],
        h=free(0.005, 0.5),
        terminal=[Constraint("arrived", x - p["way"], 0, 0), Constraint("at rest", v, 0, 0)],
        scaling=Scaling(impulse=1, gap=0.1, u=4),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the mass is at rest at the wall."""
    return bool(abs(state[0] - params.way) < 1e-3 and abs(state[1]) < 1e-3)
