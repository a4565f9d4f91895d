"""Squeeze a block between two fingers, lift it and carry it aside, at the low friction of 0.3.

It resembles pick-and-place with a parallel gripper whose fingers move independently. The block weighs 2.9 N, so that
each finger must press with at least 4.9 N before anything is lifted. Leaving the block costs at least 4. The
best-known value is plausible since relaxations, continuation from a higher friction and sampling, in that order, ended
between 0.1618 and 0.172, all with the same contact sequence.
"""

import casadi as ca
import numpy as np

from dynamics.systems import signals, time_stepping
from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table

name = "gripper"
title = "A gripper of low friction lifts a block"
FINGER, WRIST = 0.2, 0.5  # masses [kg]


class Params(Parameters):
    """Fingers move along x in the world, and the wrist moves both up and down."""

    block: float = quantity(0.3, "kg", "mass of the block", above=0)
    friction: float = quantity(0.3, "1", "Coulomb's coefficient of finger and block", least=0)
    width: float = quantity(0.1, "m", "width and height of the block", above=0)
    up: float = quantity(0.2, "m", "how high to lift", least=0)
    aside: float = quantity(0.15, "m", "how far aside")
    force: float = quantity(20.0, "N", "largest force of each motor", above=0)
    h: float = quantity(0.04, "s", "step size", above=0)
    N: int = structure(25, "number of steps", least=1)


def build(params: Params) -> Problem:
    """Build the problem; states are both fingers' x, the wrist's z, the block's x and z, and their velocities."""
    p = table(params)
    half = p["width"] / 2
    weight = 9.81 * ca.vertcat(WRIST, p["block"])
    system = time_stepping(
        name,
        states=signals(
            "left [m]; right [m]; wrist [m]; x [m] block; z [m] block; "
            "v_left [m/s]; v_right [m/s]; v_wrist [m/s]; vx [m/s] block; vz [m/s] block"
        ),
        inputs=signals("f_left [N]; f_right [N]; f_wrist [N]"),
        contacts=signals("left [N s]; right [N s]; table [N s]"),
        h=p["h"],
        mass=ca.diag(ca.vertcat(FINGER, FINGER, WRIST, p["block"], p["block"])),
        impulse=lambda q, v, u: p["h"] * ca.vertcat(u[0], u[1], u[2] - weight[0], 0, -weight[1]),
        distance=lambda q: ca.vertcat(q[3] - q[0], q[1] - q[3], q[4]) - half,
        sliding=lambda q: ca.DM([[0, 0, 1, 0, -1], [0, 0, 1, 0, -1], [0, 0, 0, 1, 0]]),
        friction=ca.vertcat(p["friction"], p["friction"], 0.3),
        parameters=p,
    )
    x = system.x
    off = x[3:5] - ca.vertcat(p["aside"], half + p["up"])
    return Problem(
        name,
        system,
        params.N,
        stage_cost=1e-4 * ca.sumsqr(system.u) + 1e-3 * ca.sumsqr(x[5:]),
        terminal_cost=100 * ca.sumsqr(off) + ca.sumsqr(x[5:]),
        x0=ca.vertcat(-0.1, 0.12, half, 0, half, ca.SX.zeros(5)),
        parameters=p,
        u_lower=-p["force"],
        u_upper=p["force"],
        scaling=Scaling(impulse=0.2, gap=0.05),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the block is held near its goal."""
    return bool(np.hypot(state[3] - params.aside, state[4] - params.up - params.width / 2) < 0.05)
