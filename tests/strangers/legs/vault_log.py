"""A point-foot hopper vaults over a log.

It resembles minimal hoppers: a body of 2 kg, a foot of 0.2 kg, and a motor that pushes them apart or together in any
direction within reach. Body and foot must get to the other side of a round log on the floor; the foot may step on the
log. Standing still costs 10 x 0.81. The best-known value is plausible since a vault is one crouch, one push and one
landing, and sampling, which also steps onto the log, ends no lower.
"""

import casadi as ca
import numpy as np

from dynamics.systems import signals, time_stepping
from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table

name = "vault-log"
title = "A hopper vaults over a log"


class Params(Parameters):
    """Body and foot are points; the log is a disc that is half below the floor."""

    body: float = quantity(2.0, "kg", "mass of the body", above=0)
    foot: float = quantity(0.2, "kg", "mass of the foot", above=0)
    log_x: float = quantity(0.45, "m", "middle of the log")
    log: float = quantity(0.15, "m", "radius of the log", above=0)
    friction: float = quantity(0.8, "1", "Coulomb's coefficient", least=0)
    goal: float = quantity(0.9, "m", "where to stand in the end")
    force: float = quantity(60.0, "N", "largest force of the leg, along either axis", above=0)
    h: float = quantity(0.025, "s", "step size", above=0)
    N: int = structure(40, "number of steps", least=1)


def build(params: Params) -> Problem:
    """Build the problem; the state is body and foot, and their velocities; the leg is 0.25 to 0.6 m long."""
    p = table(params)

    def from_log(q: ca.SX) -> ca.SX:
        """Return the vector from the log's centre to the foot."""
        return q[2:] - ca.vertcat(p["log_x"], 0)

    def sliding(q: ca.SX) -> ca.SX:
        """Return the rows of the foot's speed along the floor and round the log."""
        away = from_log(q) / ca.norm_2(from_log(q))
        return ca.vertcat(ca.SX([[0, 0, 1, 0]]), ca.horzcat(0, 0, away[1], -away[0]))

    def limits(q: ca.SX) -> ca.SX:
        """Return the distances of the leg's length from the shortest and the longest."""
        length = ca.norm_2(q[:2] - q[2:])
        return ca.vertcat(length - 0.25, 0.6 - length)

    system = time_stepping(
        name,
        states=signals(
            "bx [m] body; bz [m] body; fx [m] foot; fz [m] foot; vbx [m/s]; vbz [m/s]; vfx [m/s]; vfz [m/s]"
        ),
        inputs=signals("ux [N] of the leg on the body; uz [N] of the leg on the body"),
        contacts=signals("floor [N s]; log [N s]"),
        h=p["h"],
        mass=ca.diag(ca.vertcat(p["body"], p["body"], p["foot"], p["foot"])),
        impulse=lambda q, v, u: p["h"] * ca.vertcat(u[0], u[1] - 9.81 * p["body"], -u[0], -u[1] - 9.81 * p["foot"]),
        distance=lambda q: ca.vertcat(q[3], ca.norm_2(from_log(q)) - p["log"]),
        sliding=sliding,
        friction=p["friction"],
        limits=limits,
        limit_names=("short", "long"),
        parameters=p,
    )
    x, u = system.x, system.u
    stand = ca.vertcat(p["goal"], 0.5, p["goal"], 0)
    return Problem(
        name,
        system,
        params.N,
        stage_cost=1e-5 * (u[0] ** 2 + (u[1] - 9.81 * p["body"]) ** 2),
        terminal_cost=5 * ca.sumsqr(x[:4] - stand) + 0.1 * ca.sumsqr(x[4:]),
        x0=ca.vertcat(0, 0.5, 0, 0, 0, 0, 0, 0),
        parameters=p,
        u_lower=-p["force"],
        u_upper=p["force"],
        scaling=Scaling(impulse=0.5, gap=0.1, x=0.3, u=20),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether body and foot are beyond the log, near their goals."""
    return bool(abs(state[0] - params.goal) < 0.15 and state[2] > params.log_x + params.log)
