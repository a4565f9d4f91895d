"""Tow a sled on a slack rope to a place at its side, and let it come to rest there.

It resembles towing tasks: the rope only pulls, and only if it is taut. The tug starts next to the sled with the rope
slack by half, so that small motions of the tug do not move the sled. Drag stops the sled. Leaving it costs 10 x 1.25.
The best-known value is plausible since drag and distance fix the sled's best speed, and the rope's direction follows
the straight line from the sled to its goal after a first, bent pull.
"""

import casadi as ca
import numpy as np

from dynamics.systems import signals, time_stepping
from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table

name = "slack-tether"
title = "A sled on a slack rope"


class Params(Parameters):
    """The sled starts at the origin, the tug to its left."""

    sled: float = quantity(3.0, "kg", "mass of the sled", above=0)
    tug: float = quantity(1.0, "kg", "mass of the tug", above=0)
    rope: float = quantity(0.6, "m", "length of the rope", above=0)
    drag: float = quantity(4.0, "N s/m", "of the sled", least=0)
    goal_x: float = quantity(1.0, "m", "goal of the sled, x")
    goal_y: float = quantity(-0.5, "m", "goal of the sled, y")
    force: float = quantity(12.0, "N", "largest force on the tug, along either axis", above=0)
    h: float = quantity(0.06, "s", "step size", above=0)
    N: int = structure(40, "number of steps", least=1)


def build(params: Params) -> Problem:
    """Build the problem; the state is sled and tug, and their velocities."""
    p = table(params)
    system = time_stepping(
        name,
        states=signals("sx [m] sled; sy [m] sled; tx [m] tug; ty [m] tug; vsx [m/s]; vsy [m/s]; vtx [m/s]; vty [m/s]"),
        inputs=signals("fx [N] on the tug; fy [N] on the tug"),
        contacts=signals("rope [N s]"),
        h=p["h"],
        mass=ca.diag(ca.vertcat(p["sled"], p["sled"], p["tug"], p["tug"])),
        impulse=lambda q, v, u: p["h"] * ca.vertcat(0, 0, u),
        damping=ca.diag(ca.vertcat(p["drag"], p["drag"], 0.5, 0.5)),
        distance=lambda q: p["rope"] - ca.norm_2(q[2:] - q[:2]),
        parameters=p,
    )
    x = system.x
    off = x[:2] - ca.vertcat(p["goal_x"], p["goal_y"])
    return Problem(
        name,
        system,
        params.N,
        stage_cost=1e-3 * ca.sumsqr(system.u),
        terminal_cost=10 * ca.sumsqr(off) + ca.sumsqr(x[4:6]),
        x0=ca.vertcat(0, 0, -0.3, 0.05, 0, 0, 0, 0),
        parameters=p,
        u_lower=-p["force"],
        u_upper=p["force"],
        scaling=Scaling(impulse=0.5, gap=0.2, x=0.5, u=5),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the sled is at its goal."""
    return bool(np.hypot(state[0] - params.goal_x, state[1] - params.goal_y) < 0.15)
