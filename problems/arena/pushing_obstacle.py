"""A block that is pushed past an obstacle by a pusher that sticks to one side or slides along it."""

from __future__ import annotations

import math
from typing import ClassVar

import casadi as ca
import numpy as np

from dynamics.systems import ContactSystem, RefereeModel, signals
from ocp.problem.problem import Constraint, Problem, Scaling
from problems.arena.published import InstanceParameters, instance_parameters
from problems.drawing import Circle, Mark, Rectangle, Shape
from problems.parameters import pose_problem, quantity, structure, table
from problems.spec import Citation

name = "pushing-obstacle"
title = "Pushing a block past an obstacle, with friction (IPDDP2, 100 instances)"
citation = Citation("xu2025ipddp", "InteriorPointDDP.jl, experiments pushing_1_obs")
equations = r"""
(x, y)^+ = (x, y) + h R(theta) (f_n, f_t), quad theta^+ = theta + h z_x / (2 c^2) (f_n tan phi - f_t)
phi^+ = phi + h (a - b), quad 0 <= a perp mu f_n - f_t >= 0, quad 0 <= b perp mu f_n + f_t >= 0
f_n <= f_"max", quad abs(f_t) <= f_"max", quad a, b <= 3, quad abs(phi) <= 0.9
norm((x, y) - o)^2 >= (r + r_b)^2 - s, quad s >= 0, quad r_b = max(z_x, z_y) + 0.01
min sum_(k=0)^(N-1) w_u (f_n^2 + f_t^2) + w_s s_k + w_"end" norm((x, y, theta, phi)_N - (0.3, 0.4, 3 / 2 pi, 0))^2
"""
_DRAWN = instance_parameters(name)
RATE_LIMIT = 3.0
"""Largest rate at which the pusher's angle changes [rad/s]."""
ANGLE_LIMIT = 0.9
"""Largest angle of the pusher [rad]."""
GOAL = (0.3, 0.4, 1.5 * math.pi, 0.0)
"""State at which the block should end [m, m, rad, rad]."""


class Params(InstanceParameters):
    """Parameters of ``pushing-obstacle``; the block begins at the origin."""

    TASK: ClassVar[str] = name

    zx: float = quantity(_DRAWN["zx"], "m", "length of the block in the direction of the push", above=0)
    zy: float = quantity(_DRAWN["zy"], "m", "width of the block", above=0)
    c: float = quantity(_DRAWN["c"], "m", "largest moment of the table's friction over its force", above=0)
    friction: float = quantity(_DRAWN["friction"], "1", "Coulomb's coefficient of the pusher", above=0)
    ox: float = quantity(_DRAWN["ox"], "m", "centre of the obstacle, x")
    oy: float = quantity(_DRAWN["oy"], "m", "centre of the obstacle, y")
    r: float = quantity(_DRAWN["r"], "m", "radius of the obstacle", above=0)
    margin: float = quantity(0.01, "m", "radius of the pusher", least=0)
    h: float = quantity(0.04, "s", "step size", above=0)
    N: int = structure(100, "number of steps", least=1)
    w_u: float = quantity(1e-2, "1/N^2", "weight of the forces", least=0)
    w_s: float = quantity(2.0, "1/m^2", "weight of the part s of the obstacle's constraint that is not met", least=0)
    w_end: float = quantity(20.0, "1", "terminal weight of the distance to the goal", least=0)
    f_max: float = quantity(0.3, "N", "largest force in either direction", above=0)
    damper: float = quantity(0.1, "N s/rad", "unit of the inputs per rate of sliding, which changes no motion", above=0)


def build(params: Params) -> Problem:
    """Return the problem with steps (pushing-obstacle.1, 2) and cost (pushing-obstacle.5).

    The inputs y are the margins of the friction cone less ``damper`` times the rates: ``mu f_n - f_t = y_1 +
    damper a`` and ``mu f_n + f_t = y_2 + damper b``, which gives the forces, and a = max(-y_1, 0) / damper. The mass
    of the source is 1 s/kg, so that a force of 1 N moves the block by 1 m/s.
    """
    p = table(params)
    x, x_next, u, lam = (ca.SX.sym(s, k) for s, k in (("x", 4), ("x_next", 4), ("u", 3), ("lam", 2)))
    margins = u[:2] + p["damper"] * lam
    force = ca.vertcat((margins[0] + margins[1]) / (2 * p["friction"]), (margins[1] - margins[0]) / 2)
    cos, sin = ca.cos(x[2]), ca.sin(x[2])
    angular_velocity = p["zx"] / (2 * p["c"] ** 2) * (force[0] * ca.tan(x[3]) - force[1])
    rate = ca.vertcat(
        cos * force[0] - sin * force[1], sin * force[0] + cos * force[1], angular_velocity, lam[0] - lam[1]
    )
    system = ContactSystem(
        name=name,
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=x_next - x - p["h"] * rate,
        gap=margins,
        states=signals("x [m] block; y [m] block; theta [rad] block, anticlockwise; phi [rad] pusher"),
        inputs=signals("y1 [N] margin less rate; y2 [N] margin less rate; s [m^2] part of the constraint not met"),
        contacts=signals("left [rad/s] sliding; right [rad/s] sliding"),
        h=p["h"],
        parameters=p,
        gap_unit="N",
        referee_model=RefereeModel(),
    )
    clearance = p["r"] + ca.fmax(p["zx"], p["zy"]) + p["margin"]
    squared_distance = ca.sumsqr(x[:2] - ca.vertcat(p["ox"], p["oy"]))
    return pose_problem(
        params,
        system,
        stage_cost=p["w_u"] * ca.sumsqr(force) + p["w_s"] * u[2],
        terminal_cost=p["w_end"] * ca.sumsqr(x - ca.DM(GOAL)),
        x0=ca.SX.zeros(4),
        u_lower=ca.SX([-ca.inf, -ca.inf, 0.0]),
        x_lower=ca.SX([-ca.inf, -ca.inf, -ca.inf, -ANGLE_LIMIT]),
        x_upper=ca.SX([ca.inf, ca.inf, ca.inf, ANGLE_LIMIT]),
        path=[
            Constraint("force", force, -p["f_max"], p["f_max"]),
            Constraint("rate", lam, -ca.inf, RATE_LIMIT),
            Constraint("obstacle", squared_distance + u[2] - clearance**2, 0.0, ca.inf),
        ],
        scaling=Scaling(impulse=1.0, gap=0.1, x=0.3, u=0.1),
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw block, obstacle, goal and the point of contact."""
    x, y, angle, phi = (float(value) for value in state)
    along, across = -params.zx / 2, -params.zx / 2 * math.tan(phi)
    cos, sin = math.cos(angle), math.sin(angle)
    return [
        Circle(params.ox, params.oy, params.r, "environment"),
        Rectangle(*GOAL[:2], params.zx, params.zy, GOAL[2], "goal"),
        Rectangle(x, y, params.zx, params.zy, angle),
        Mark(x + cos * along - sin * across, y + sin * along + cos * across, "actuator"),
    ]
