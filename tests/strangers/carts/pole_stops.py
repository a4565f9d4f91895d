"""Swing a pendulum up on a cart that runs between two elastic stops.

It is the cart-pole's swing-up with a track of 0.7 m that ends in sprung buffers and a motor of 5 N. The pendulum hangs
at first and is upright at the end. The buffers may be used to turn the cart round. The best-known value is plausible
since the swing-up without stops is well studied, with two or three swings, and the stops only add the choice of which
swing meets a buffer.
"""

import casadi as ca
import numpy as np

from dynamics.systems import signals, time_stepping
from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table

name = "pole-stops"
title = "A pendulum on a cart between elastic stops"


class Params(Parameters):
    """The angle is 0 if the pendulum hangs; buffers extend inwards from both ends."""

    cart: float = quantity(1.0, "kg", "mass of the cart", above=0)
    bob: float = quantity(0.3, "kg", "mass of the bob", above=0)
    rod: float = quantity(0.4, "m", "length of the massless rod", above=0)
    track: float = quantity(0.35, "m", "way to either buffer", above=0)
    buffer: float = quantity(0.05, "kg", "mass of a buffer", above=0)
    spring: float = quantity(150.0, "N/m", "of a buffer", above=0)
    force: float = quantity(5.0, "N", "largest force on the cart", above=0)
    h: float = quantity(0.04, "s", "step size", above=0)
    N: int = structure(55, "number of steps", least=1)


def build(params: Params) -> Problem:
    """Build the problem; the state is cart, angle, left and right buffer, and their velocities."""
    p = table(params)
    whole, pull = p["cart"] + p["bob"], p["bob"] * p["rod"]

    def mass(q: ca.SX) -> ca.SX:
        """Return the mass matrix of cart, pendulum and buffers."""
        pendulum = ca.vertcat(ca.horzcat(whole, pull * ca.cos(q[1])), ca.horzcat(pull * ca.cos(q[1]), pull * p["rod"]))
        return ca.diagcat(pendulum, p["buffer"], p["buffer"])

    def impulse(q: ca.SX, v: ca.SX, u: ca.SX) -> ca.SX:
        """Return the impulses of the motor, of the bob's swing, and of gravity on it."""
        on_cart = u + pull * ca.sin(q[1]) * v[1] ** 2
        return p["h"] * ca.vertcat(on_cart, -9.81 * pull * ca.sin(q[1]), 0, 0)

    system = time_stepping(
        name,
        states=signals(
            "x [m] cart; a [rad] pendulum; left [m] buffer; right [m] buffer; "
            "vx [m/s]; va [rad/s]; v_left [m/s]; v_right [m/s]"
        ),
        inputs=signals("f [N] on the cart"),
        contacts=signals("left [N s] buffer; right [N s] buffer"),
        h=p["h"],
        mass=mass,
        impulse=impulse,
        stiffness=ca.diag(ca.vertcat(0, 0, p["spring"], p["spring"])),
        damping=ca.diag(ca.DM([0, 0, 0.5, 0.5])),
        distance=lambda q: ca.vertcat(q[0] - q[2], q[3] - q[0]) + p["track"],
        parameters=p,
    )
    x = system.x
    off = ca.vertcat(x[0], x[1] - np.pi, 0.3 * x[4], 0.3 * x[5])
    return Problem(
        name,
        system,
        params.N,
        stage_cost=1e-3 * system.u**2,
        terminal_cost=20 * ca.sumsqr(off),
        x0=ca.DM.zeros(8),
        parameters=p,
        u_lower=-p["force"],
        u_upper=p["force"],
        scaling=Scaling(impulse=0.5, gap=0.1, x=0.5, u=3),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the pendulum is upright."""
    return abs(state[1] - np.pi) < 0.3
