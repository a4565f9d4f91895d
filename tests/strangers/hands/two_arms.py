"""Two arms bring one box to a pose that one arm alone cannot reach; inches, pounds and seconds.

It resembles bimanual pushing with quasi-dynamic steps: each fingertip is held by a spring of its arm, the left one
at the box's left face and the right one at its right face, and neither may cross the centre line. The box must go up
and turn: both fingers carry it by friction between them, or each pushes its own side. The best-known value is the
cheapest of all relaxations and of sampling, and plausible since the box must be carried by friction between both
fingers, and their paths are short.
"""

import casadi as ca
import numpy as np

from dynamics.systems import quasi_dynamic, signals
from dynamics.systems.shapes import Box, Contact, Disc, Pose
from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table

name = "two-arms"
title = "Two arms move one box"


class Params(Parameters):
    """The box is a square of eight inches; a finger's radius is one inch."""

    half: float = quantity(4.0, "in", "half side of the box", above=0)
    tip: float = quantity(1.0, "in", "radius of a finger", above=0)
    friction: float = quantity(0.5, "1", "Coulomb's coefficient", least=0)
    goal_x: float = quantity(3.0, "in", "goal of the box, x")
    goal_y: float = quantity(6.0, "in", "goal of the box, y")
    turn: float = quantity(0.3, "rad", "turn wanted, anticlockwise")
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(30, "number of steps", least=1)


def build(params: Params) -> Problem:
    """Build the problem; states are the box's position and angle and both fingers, inputs their commands."""
    p = table(params)
    box, tip = Box((p["half"], p["half"])), Disc(p["tip"])

    def contacts(q: ca.SX) -> list[Contact]:
        """Return the contacts of the fingers with the box."""
        held = Pose(q[:2], -q[2])
        return [Contact.between(box, held, tip, Pose(place, ca.SX(0))) for place in (q[3:5], q[5:7])]

    system = quasi_dynamic(
        name,
        states=signals(
            "x [in] box; y [in] box; a [rad] box; lx [in] left finger; ly [in] left finger; "
            "rx [in] right finger; ry [in] right finger"
        ),
        inputs=signals("ulx [in]; uly [in]; urx [in]; ury [in]"),
        contacts=signals("left [lb in/s]; right [lb in/s]"),
        h=p["h"],
        mass=ca.diag(ca.vertcat(2, 2, 2 * 32 / 3)),
        stiffness=ca.diag(ca.DM([100.0, 100.0, 100.0, 100.0])),
        distance=lambda q: ca.vertcat(*(contact.phi for contact in contacts(q))),
        sliding=lambda q: ca.vertcat(*(contact.jacobians(q)[1] for contact in contacts(q))),
        friction=p["friction"],
        cone="linearised",
        parameters=p,
    )
    x = system.x
    off = ca.vertcat(x[0] - p["goal_x"], x[1] - p["goal_y"], p["half"] * (x[2] - p["turn"]))
    du = ca.SX.sym("du", 4)
    start = ca.vertcat(-6, -1, 6, 1)
    return Problem(
        name,
        system,
        params.N,
        stage_cost=0.002 * ca.sumsqr(off) + 0.02 * ca.sumsqr(du),
        terminal_cost=ca.sumsqr(off),
        x0=ca.vertcat(0, 0, 0, start),
        parameters=p,
        du=du,
        u_before=start,
        u_lower=ca.DM([-15, -15, 2, -15]),
        u_upper=ca.DM([1, 15, 15, 15]),
        scaling=Scaling(gap=2, x=5, u=5),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the box is within an inch of its goal, and turned as required."""
    off = state[:2] - [params.goal_x, params.goal_y]
    return bool(np.hypot(*off) < 1 and abs(state[2] - params.turn) < 0.15)
