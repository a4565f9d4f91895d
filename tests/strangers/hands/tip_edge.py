"""Tip a crate onto one of its lower edges and leave it balanced there.

It resembles how movers walk a fridge: a hand on a rail pushes high on the left face, friction under the right edge
holds it, and the crate must end at rest with its centre of mass above that edge, turned by atan(0.2 / 0.5). Pushing
it over costs more than not pushing at all. The best-known value is plausible since the energy of the tip is fixed, so
that the least effort is to push just long enough, and relaxations and sampling end no lower.
"""

import casadi as ca
import numpy as np

from dynamics.systems import signals, time_stepping
from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table

name = "tip-edge"
title = "A crate tipped onto its edge"


class Params(Parameters):
    """Lengths of the crate are half sides in metres."""

    mass: float = quantity(4.0, "kg", "mass of the crate", above=0)
    a: float = quantity(0.1, "m", "half width", above=0)
    b: float = quantity(0.25, "m", "half height", above=0)
    high: float = quantity(0.4, "m", "height of the hand's rail above the floor", above=0)
    friction: float = quantity(0.6, "1", "Coulomb's coefficient with the floor", least=0)
    force: float = quantity(30.0, "N", "largest force of the hand", above=0)
    h: float = quantity(0.03, "s", "step size", above=0)
    N: int = structure(40, "number of steps", least=1)


def build(params: Params) -> Problem:
    """Build the problem; the state is the crate's centre and clockwise angle, the hand, and their velocities."""
    p = table(params)
    inertia = p["mass"] * ((2 * p["a"]) ** 2 + (2 * p["b"]) ** 2) / 12

    def corner(q: ca.SX, side: float) -> ca.SX:
        """Return the position of a lower corner, to the left or right of the centre."""
        c, s = ca.cos(q[2]), ca.sin(q[2])
        return ca.vertcat(q[0] + side * p["a"] * c - p["b"] * s, q[1] - side * p["a"] * s - p["b"] * c)

    def distance(q: ca.SX) -> ca.SX:
        """Return the heights of both corners, and the hand's distance perpendicular to the left face."""
        c, s = ca.cos(q[2]), ca.sin(q[2])
        face = (q[0] - q[3]) * c - (q[1] - p["high"]) * s - p["a"]
        return ca.vertcat(corner(q, -1)[1], corner(q, 1)[1], face)

    def sliding(q: ca.SX) -> ca.SX:
        """Return the rows of sliding of both corners along the floor; the hand is frictionless."""
        feet = ca.vertcat(corner(q, -1)[0], corner(q, 1)[0])
        return ca.vertcat(ca.jacobian(feet, q), ca.SX(1, 4))

    system = time_stepping(
        name,
        states=signals(
            "x [m] crate; z [m] crate; a [rad] crate; hand [m]; vx [m/s]; vz [m/s]; va [rad/s]; v_hand [m/s]"
        ),
        inputs=signals("f [N] on the hand"),
        contacts=signals("left [N s] edge; right [N s] edge; hand [N s]"),
        h=p["h"],
        mass=ca.diag(ca.vertcat(p["mass"], p["mass"], inertia, 0.5)),
        impulse=lambda q, v, u: p["h"] * ca.vertcat(0, -9.81 * p["mass"], 0, u),
        distance=distance,
        sliding=sliding,
        friction=ca.vertcat(p["friction"], p["friction"], 0),
        parameters=p,
    )
    x = system.x
    goal = ca.atan2(p["a"], p["b"])
    return Problem(
        name,
        system,
        params.N,
        stage_cost=1e-4 * system.u**2,
        terminal_cost=100 * (x[2] - goal) ** 2 + ca.sumsqr(x[4:]),
        x0=ca.vertcat(0, p["b"], 0, -p["a"] - 0.05, 0, 0, 0, 0),
        parameters=p,
        u_lower=-p["force"],
        u_upper=p["force"],
        scaling=Scaling(impulse=1, gap=0.05, x=0.2, u=10),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the crate is on its edge, close to balance."""
    return abs(state[2] - np.arctan2(params.a, params.b)) < 0.05
