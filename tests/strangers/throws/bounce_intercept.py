"""Meet a ball after its bounce and knock it to a mark.

It resembles ping-pong robots. The ball falls on a plate on a spring, which throws it up again, and passes in front of
a round bat that a force moves in the plane. Without a knock it ends 1.5 m away from the mark, up on the left. The
best-known value is plausible since the ball's path to the bat is given, and one knock has three numbers, its time,
direction and strength, which sampling covers.
"""

import casadi as ca
import numpy as np

from dynamics.systems import signals, time_stepping
from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table

name = "bounce-intercept"
title = "A bat meets a bouncing ball"


class Params(Parameters):
    """The ball starts at (-0.8, 0.6) and moves to the right."""

    ball: float = quantity(0.1, "kg", "mass of the ball", above=0)
    plate: float = quantity(0.02, "kg", "mass of the plate", above=0)
    spring: float = quantity(80.0, "N/m", "of the plate", above=0)
    bat: float = quantity(0.4, "kg", "mass of the bat", above=0)
    reach: float = quantity(0.1, "m", "radii of ball and bat together", above=0)
    speed: float = quantity(1.2, "m/s", "of the ball, to the right")
    mark_x: float = quantity(-0.3, "m", "mark, x")
    mark_z: float = quantity(0.8, "m", "mark, z")
    force: float = quantity(10.0, "N", "largest force on the bat, beyond its weight", above=0)
    h: float = quantity(0.025, "s", "step size", above=0)
    N: int = structure(50, "number of steps", least=1)


def build(params: Params) -> Problem:
    """Build the problem; the state is ball, plate (0 at its spring's rest), bat, and their velocities."""
    p = table(params)
    system = time_stepping(
        name,
        states=signals(
            "x [m] ball; z [m] ball; plate [m]; bx [m] bat; bz [m] bat; "
            "vx [m/s]; vz [m/s]; v_plate [m/s]; vbx [m/s]; vbz [m/s]"
        ),
        inputs=signals("fx [N] on the bat; fz [N] on the bat"),
        contacts=signals("plate [N s]; bat [N s]"),
        h=p["h"],
        mass=ca.diag(ca.vertcat(p["ball"], p["ball"], p["plate"], p["bat"], p["bat"])),
        impulse=lambda q, v, u: p["h"] * ca.vertcat(0, -9.81 * p["ball"], -p["spring"] * q[2] - 0.1 * v[2], u),
        distance=lambda q: ca.vertcat(q[1] - q[2], ca.norm_2(q[3:] - q[:2]) - p["reach"]),
        parameters=p,
    )
    x = system.x
    return Problem(
        name,
        system,
        params.N,
        stage_cost=5e-4 * ca.sumsqr(system.u),
        terminal_cost=10 * ((x[0] - p["mark_x"]) ** 2 + (x[1] - p["mark_z"]) ** 2),
        x0=ca.vertcat(-0.8, 0.6, 0, 0.6, 0.3, p["speed"], 0, 0, 0, 0),
        parameters=p,
        u_lower=-p["force"],
        u_upper=p["force"],
        scaling=Scaling(impulse=0.2, gap=0.1, x=0.5, u=3),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the ball is near its mark."""
    return bool(np.hypot(state[0] - params.mark_x, state[1] - params.mark_z) < 0.15)
