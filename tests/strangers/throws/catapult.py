"""Shoot a ball with a catapult whose arm hits an end stop.

It resembles teaching examples on hybrid systems. The ball lies on the arm's smooth upper side behind a lip, and the
motor swings the arm up from the left; the stop holds the arm at 135 degrees, and the ball flies on. At the last step
it must be at (2, 0.5). Without a swing it stays at (-0.5, 0). The best-known value is plausible since the release is
at the stop in every good plan, which leaves one number to choose, the speed there.
"""

import casadi as ca
import numpy as np

from dynamics.systems import signals, time_stepping
from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table

name = "catapult"
title = "A catapult with an end stop"


class Params(Parameters):
    """Angles are anticlockwise from +x: the arm starts at pi, and its angle decreases to that of the stop."""

    ball: float = quantity(0.1, "kg", "mass of the ball", above=0)
    inertia: float = quantity(0.08, "kg m^2", "of the arm about its hinge", above=0)
    length: float = quantity(0.5, "m", "way of the lip from the hinge", above=0)
    stop: float = quantity(0.75 * np.pi, "rad", "where the end stop holds the arm")
    friction: float = quantity(0.4, "1", "Coulomb's coefficient of the ball on the arm", least=0)
    torque: float = quantity(12.0, "N m", "largest torque", above=0)
    h: float = quantity(0.025, "s", "step size", above=0)
    N: int = structure(45, "number of steps", least=1)


def build(params: Params) -> Problem:
    """Build the problem; the state is the arm's angle, the ball's position, and their velocities."""
    p = table(params)

    def along(q: ca.SX) -> ca.SX:
        """Return the position of the ball along the arm."""
        return q[1] * ca.cos(q[0]) + q[2] * ca.sin(q[0])

    def above(q: ca.SX) -> ca.SX:
        """Return the height of the ball over the arm's upper side."""
        return q[1] * ca.sin(q[0]) - q[2] * ca.cos(q[0])

    def sliding(q: ca.SX) -> ca.SX:
        """Return the row of the ball's speed along the arm; the lip is frictionless."""
        row = ca.jacobian(along(q), q)
        row[0] = 0
        return ca.vertcat(row, ca.SX(2, 3))

    system = time_stepping(
        name,
        states=signals("a [rad] arm; x [m] ball; z [m] ball; va [rad/s]; vx [m/s]; vz [m/s]"),
        inputs=signals("torque [N m] that swings it up"),
        contacts=signals("arm [N s]; lip [N s]; stop [N m s]"),
        h=p["h"],
        mass=ca.diag(ca.vertcat(p["inertia"], p["ball"], p["ball"])),
        impulse=lambda q, v, u: p["h"] * ca.vertcat(-u, 0, -9.81 * p["ball"]),
        distance=lambda q: ca.vertcat(above(q), p["length"] - along(q), q[0] - p["stop"]),
        sliding=sliding,
        friction=ca.vertcat(p["friction"], 0, 0),
        parameters=p,
    )
    x = system.x
    return Problem(
        name,
        system,
        params.N,
        stage_cost=1e-3 * system.u**2,
        terminal_cost=5 * ((x[1] - 2) ** 2 + (x[2] - 0.5) ** 2),
        x0=ca.vertcat(np.pi, -p["length"], 0, 0, 0, 0),
        parameters=p,
        u_lower=-p["torque"],
        u_upper=p["torque"],
        x_upper=ca.DM([np.pi + 0.01] + [ca.inf] * 5),
        scaling=Scaling(impulse=0.2, gap=0.1, x=0.5, u=3),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the ball is near the target."""
    return bool(np.hypot(state[1] - 2, state[2] - 0.5) < 0.15)
