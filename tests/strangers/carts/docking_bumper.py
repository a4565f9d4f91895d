"""Dock a capsule whose thrusters are too weak to brake it without its bumper; inches, pounds and seconds.

It resembles docking with an androgynous ring: the port's ring is light and supported by a spring with a damper. The
capsule comes in at 12 in/s, the thrusters alone would need more than the remaining distance, and at the end it must
rest against the ring, pressed in by half an inch. The best-known value is plausible since the bumper's push fixes the
rest of the motion: the program is nearly a linear-quadratic one once the time of contact is known.
"""

import casadi as ca
import numpy as np

from dynamics.systems import signals, time_stepping
from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table

name = "docking-bumper"
title = "A capsule docks against a bumper"


class Params(Parameters):
    """Lengths in inches, masses in pounds."""

    capsule: float = quantity(2000.0, "lb", "mass of the capsule", above=0)
    ring: float = quantity(20.0, "lb", "mass of the ring", above=0)
    spring: float = quantity(8000.0, "lb/s^2", "of the ring", above=0)
    damper: float = quantity(1500.0, "lb/s", "of the ring", least=0)
    speed: float = quantity(12.0, "in/s", "approach")
    thrust: float = quantity(5000.0, "lb in/s^2", "largest, either way", above=0)
    h: float = quantity(0.1, "s", "step size", above=0)
    N: int = structure(50, "number of steps", least=1)


def build(params: Params) -> Problem:
    """Build the problem; states are capsule and ring, from the ring's rest position, and their velocities."""
    p = table(params)
    system = time_stepping(
        name,
        states=signals("capsule [in]; ring [in]; v_capsule [in/s]; v_ring [in/s]"),
        inputs=signals("thrust [lb in/s^2]"),
        contacts=signals("ring [lb in/s]"),
        h=p["h"],
        mass=ca.diag(ca.vertcat(p["capsule"], p["ring"])),
        impulse=lambda q, v, u: p["h"] * ca.vertcat(u, 0),
        stiffness=ca.diag(ca.vertcat(0, p["spring"])),
        damping=ca.diag(ca.vertcat(0, p["damper"])),
        distance=lambda q: q[1] - q[0],
        parameters=p,
    )
    x = system.x
    return Problem(
        name,
        system,
        params.N,
        stage_cost=1e-8 * system.u**2,
        terminal_cost=10 * (x[0] - 0.5) ** 2 + 10 * x[2] ** 2,
        x0=ca.vertcat(-15, 0, p["speed"], 0),
        parameters=p,
        u_lower=-p["thrust"],
        u_upper=p["thrust"],
        scaling=Scaling(gap=2, x=5, u=2000),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the capsule rests at the ring."""
    return bool(abs(state[0] - 0.5) < 0.3 and abs(state[2]) < 0.5)
