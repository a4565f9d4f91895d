"""Stop a cart at a mark with a brake shoe, the only actuator; millimetres, kilograms and seconds.

It resembles stick-slip exercises. A spring lifts the shoe 4 mm off the cart; a force presses it down, and friction
stops the cart. Full braking stops it short of the mark, and without braking it rolls 800 mm beyond. The best-known
value is plausible since the cart's energy fixes the integral of the pressing force, which the best plans spread
evenly, as its square is the cost: a closed form except for the shoe's motion down.
"""

import casadi as ca
import numpy as np

from dynamics.systems import signals, time_stepping
from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table

name = "brake-mark"
title = "A brake stops a cart at a mark"


class Params(Parameters):
    """Forces in kg mm/s^2, which is a millinewton."""

    cart: float = quantity(2.0, "kg", "mass of the cart", above=0)
    shoe: float = quantity(0.1, "kg", "mass of the shoe", above=0)
    lift: float = quantity(4.0, "mm", "of the shoe above the cart", above=0)
    spring: float = quantity(200.0, "kg/s^2", "that lifts the shoe", above=0)
    friction: float = quantity(0.35, "1", "Coulomb's coefficient of the shoe", least=0)
    speed: float = quantity(1200.0, "mm/s", "of the cart at the start")
    mark: float = quantity(1000.0, "mm", "where to stop")
    press: float = quantity(10000.0, "mN", "largest force on the shoe", above=0)
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(36, "number of steps", least=1)


def build(params: Params) -> Problem:
    """Build the problem; the state is the cart's position, the shoe's height over it, and their velocities."""
    p = table(params)
    system = time_stepping(
        name,
        states=signals("x [mm] cart; z [mm] shoe; vx [mm/s] cart; vz [mm/s] shoe"),
        inputs=signals("press [mN] on the shoe"),
        contacts=signals("shoe [kg mm/s]"),
        h=p["h"],
        mass=ca.diag(ca.vertcat(p["cart"], p["shoe"])),
        impulse=lambda q, v, u: p["h"] * ca.vertcat(0, p["spring"] * p["lift"] - u),
        stiffness=ca.diag(ca.vertcat(0, p["spring"])),
        distance=lambda q: q[1],
        sliding=lambda q: ca.DM([[1, 0]]),
        friction=p["friction"],
        parameters=p,
    )
    x = system.x
    return Problem(
        name,
        system,
        params.N,
        stage_cost=1e-8 * system.u**2,
        terminal_cost=1e-3 * (x[0] - p["mark"]) ** 2 + 1e-3 * x[2] ** 2,
        x0=ca.vertcat(0, p["lift"], p["speed"], 0),
        parameters=p,
        u_lower=0,
        u_upper=p["press"],
        scaling=Scaling(gap=2, x=100, u=2000),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the cart is at rest at its mark."""
    return bool(abs(state[0] - params.mark) < 30 and abs(state[2]) < 50)
