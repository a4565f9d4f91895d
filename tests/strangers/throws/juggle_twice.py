"""Juggle a ball twice: it must be at a height of 1 m at half of the time and again at the end.

It resembles paddle juggling. Impacts are plastic, so that the paddle catches the ball, and throws it by braking first.
A clock as a coordinate lets the running cost select the middle. Holding the ball still costs 2 x 10 x 0.9^2. The
best-known value is plausible since gravity and the time fix the flight between the two throws, and what is left are
two smooth strokes of one motor; a height of 1 m is out of the paddle's own range.
"""

import casadi as ca
import numpy as np

from dynamics.systems import signals, time_stepping
from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table

name = "juggle-twice"
title = "A ball juggled twice"


class Params(Parameters):
    """The paddle moves between 0 and 0.4 m."""

    ball: float = quantity(0.1, "kg", "mass of the ball", above=0)
    paddle: float = quantity(0.4, "kg", "mass of the paddle", above=0)
    high: float = quantity(1.0, "m", "height wanted, twice")
    force: float = quantity(30.0, "N", "largest force on the paddle, beyond its weight", above=0)
    h: float = quantity(0.035, "s", "step size", above=0)
    N: int = structure(50, "number of steps", least=1)


def build(params: Params) -> Problem:
    """Build the problem; the state is ball, paddle, clock, and their velocities; the ball is a point."""
    p = table(params)
    system = time_stepping(
        name,
        states=signals("ball [m]; paddle [m]; t [s]; v_ball [m/s]; v_paddle [m/s]; rate [1]"),
        inputs=signals("f [N] on the paddle"),
        contacts=signals("bat [N s]"),
        h=p["h"],
        mass=ca.diag(ca.vertcat(p["ball"], p["paddle"], 1)),
        impulse=lambda q, v, u: p["h"] * ca.vertcat(-9.81 * p["ball"], u, 0),
        distance=lambda q: q[0] - q[1],
        parameters=p,
    )
    x = system.x
    middle = ca.exp(-(((x[2] - params.N / 2 * p["h"]) / (0.5 * p["h"])) ** 2))
    free = ca.DM([ca.inf] * 6)
    return Problem(
        name,
        system,
        params.N,
        stage_cost=10 * middle * (x[0] - p["high"]) ** 2 + 1e-4 * system.u**2,
        terminal_cost=10 * (x[0] - p["high"]) ** 2,
        x0=ca.vertcat(0.1, 0.1, 0, 0, 0, 1),
        parameters=p,
        u_lower=-p["force"],
        u_upper=p["force"],
        x_lower=ca.vertcat(-free[0], 0, -free[2:]),
        x_upper=ca.vertcat(free[0], 0.4, free[2:]),
        scaling=Scaling(impulse=0.2, gap=0.1, x=0.5, u=5),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the ball is at its height at the end."""
    return abs(state[0] - params.high) < 0.15
