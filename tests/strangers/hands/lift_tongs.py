"""Lift a block with a pair of tongs, by friction alone; millimetres, grams and milliseconds, so a force is in newtons.

It resembles pick-up tasks of manipulation courses. One motor closes both jaws, the other lifts them. The block
of 200 g weighs 1.96 N, so that at friction 0.4 the jaws must squeeze it with 2.45 N each before it leaves the table.
The best-known value is the cheapest of sampling, relaxations and barrier plans made exact. It is plausible since it
is below that of a slow lift, which keeps the minimum squeeze and the weight over all steps and costs about 0.2: the
tongs already move up when they close, and the squeeze is short.
"""

import casadi as ca
import numpy as np

from dynamics.systems import signals, time_stepping
from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table

name = "lift-tongs"
title = "Tongs lift a block by friction"


class Params(Parameters):
    """The block is 40 mm wide, and the jaws start 20 mm away from it on both sides."""

    block: float = quantity(200.0, "g", "mass of the block", above=0)
    jaw: float = quantity(50.0, "g", "mass of both jaws", above=0)
    arm: float = quantity(300.0, "g", "mass of the tongs", above=0)
    friction: float = quantity(0.4, "1", "Coulomb's coefficient of the jaws", least=0)
    half_width: float = quantity(20.0, "mm", "half the block's width", above=0)
    lift: float = quantity(80.0, "mm", "how high to lift")
    g: float = quantity(9.81e-3, "mm/ms^2", "gravity", above=0)
    h: float = quantity(25.0, "ms", "step size", above=0)
    N: int = structure(30, "number of steps", least=1)


def build(params: Params) -> Problem:
    """Build the problem; the state is half the jaws' opening, heights of tongs and block, and velocities."""
    p = table(params)
    system = time_stepping(
        name,
        states=signals(
            "s [mm] half opening; zt [mm] tongs; zb [mm] block; vs [mm/ms] jaws; vt [mm/ms] tongs; vb [mm/ms] block"
        ),
        inputs=signals("close [N] on both jaws; raise [N] on the tongs beyond their weight"),
        contacts=signals("jaws [g mm/ms]; table [g mm/ms]"),
        h=p["h"],
        mass=ca.diag(ca.vertcat(p["jaw"], p["arm"], p["block"])),
        impulse=lambda q, v, u: p["h"] * ca.vertcat(-u[0], u[1], -p["block"] * p["g"]),
        distance=lambda q: ca.vertcat(q[0] - p["half_width"], q[2]),
        sliding=lambda q: ca.DM([[0, 1, -1], [0, 0, 0]]),
        friction=ca.vertcat(2 * p["friction"], 0),  # the normal force of both jaws is on one row
        parameters=p,
    )
    x, u = system.x, system.u
    return Problem(
        name,
        system,
        params.N,
        stage_cost=1e-3 * ca.sumsqr(u),
        terminal_cost=1e-3 * (x[2] - p["lift"]) ** 2 + 10 * ca.sumsqr(x[3:]),
        x0=ca.vertcat(40, 0, 0, 0, 0, 0),
        parameters=p,
        u_lower=-12,
        u_upper=12,
        scaling=Scaling(gap=10, x=20, u=3),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the block is lifted to within a centimetre of its goal."""
    return abs(state[2] - params.lift) < 10
