"""A hopper of one massless leg, whose equations switch between stance and flight."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.systems import ContactSystem, ParameterTable, RefereeModel, signals
from ocp.problem.problem import Constraint, Problem, Scaling
from problems.drawing import Circle, Mark, Segment, Shape, Wall
from problems.parameters import Parameters, pose_problem, quantity, structure, table
from problems.spec import Citation

name = "stance-hopper"
title = "Hopper with stance and flight, by vanishing constraints (CRISP)"
citation = Citation("li2025crisp", "CRISP's code, src/examples, 2dHopper")
axes = ("x [m]", "y [m]")
equations = r"""
m dot(p)_x^+ = m dot(p)_x - h u_2 sin theta, quad m dot(p)_y^+ = m dot(p)_y + h (u_2 cos theta - m g), quad
  p^+ = p + h dot(p)^+
(l_0 - r) cos theta = p_y - q_y, quad (l_0 - r) sin theta = q_x - p_x
q_x^+ = q_x + d_1 - d_2, quad q_y^+ = z - q_y, quad theta^+ = theta + h (u_1 + e_1 - e_2), quad u_1 = f_1 - f_2
0 <= z, d, f perp r >= 0, quad 0 <= u_2, e perp q_y >= 0
r <= r_0, quad q_y + r + s >= 0.1, quad s >= 0
min w_"end" norm(x_N - x_"goal")^2 + sum_(k=0)^(N-1) w_1 u_(1,k)^2 + w_2 u_(2,k)^2 + w_s s_k^2
"""
START = (0.0, 1.5, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0)
"""State at the start, in the order of the states [m, rad, m/s]."""
GOAL = (2.0, 1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""State at which the hopper should end [m, rad, m/s]."""


class Params(Parameters):
    """Parameters of ``stance-hopper``, with the source's values."""

    m: float = quantity(1.0, "kg", "mass of the body", above=0)
    l0: float = quantity(1.0, "m", "length of the leg", above=0)
    r0: float = quantity(0.8, "m", "largest retraction of the leg", above=0)
    g: float = quantity(9.81, "m/s^2", "gravity", above=0)
    clearance: float = quantity(0.1, "m", "height of the foot plus retraction that costs nothing", least=0)
    h: float = quantity(0.02, "s", "step size", above=0)
    N: int = structure(199, "number of steps", least=1)
    w_end: float = quantity(100.0, "1", "terminal weight of every state", least=0)
    w_1: float = quantity(1e-3, "s^2/rad^2", "weight of the leg's rate in flight", least=0)
    w_2: float = quantity(1e-5, "1/N^2", "weight of the thrust", least=0)
    w_s: float = quantity(100.0, "1/m^2", "weight of the missing clearance", least=0)


def build(params: Params) -> Problem:
    """Return the problem with steps (stance-hopper.1), (stance-hopper.3) and pairs (stance-hopper.4).

    In stance, r > 0, the foot stays on the ground and the leg turns about it; in flight, q_y > 0, the leg has
    its full length and turns at the rate u_1. The pair of r and q_y at the last node is left out.
    """
    p = table(params)
    system = _system(p)
    x, u, lam = system.x, system.u, system.lam
    extent = p["l0"] - x[5]
    leg = ca.vertcat(extent * ca.cos(x[4]) - x[1] + x[3], extent * ca.sin(x[4]) - x[2] + x[0])
    swing = lam[5] - lam[6]
    return pose_problem(
        params,
        system,
        stage_cost=p["w_1"] * swing**2 + p["w_2"] * lam[7] ** 2 + p["w_s"] * u[1] ** 2,
        terminal_cost=p["w_end"] * ca.sumsqr(x - ca.DM(GOAL)),
        x0=ca.DM(START),
        u_lower=ca.SX([-ca.inf, 0]),
        x_lower=ca.SX([-ca.inf, -ca.inf, -ca.inf, 0, -ca.inf, 0, -ca.inf, -ca.inf]),
        x_upper=ca.vertcat(ca.SX([ca.inf] * 5), p["r0"], ca.SX([ca.inf] * 2)),
        path=[
            Constraint("leg", leg, 0.0, 0.0),
            Constraint("clearance", x[3] + x[5] + u[1] - p["clearance"], 0.0, ca.inf),
        ],
        terminal=[Constraint("leg", leg, 0.0, 0.0)],
        scaling=Scaling(impulse=1.0, gap=0.5, x=0.5, u=1.0),
    )


def _system(p: ParameterTable) -> ContactSystem:
    x, x_next, u, lam = (ca.SX.sym(s, k) for s, k in (("x", 8), ("x_next", 8), ("u", 2), ("lam", 8)))
    h, retraction, height, thrust = p["h"], x[5], x[3], lam[7]
    force = ca.vertcat(-thrust * ca.sin(x[4]), thrust * ca.cos(x[4]) - p["m"] * p["g"])
    v_next = x[6:] + h * force / p["m"]
    rate = lam[5] - lam[6] + lam[3] - lam[4]
    foot_next = ca.vertcat(x[2] + lam[1] - lam[2], lam[0] - height)
    return ContactSystem(
        name=name,
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=x_next - ca.vertcat(x[:2] + h * v_next, foot_next, x[4] + h * rate, retraction + h * u[0], v_next),
        gap=ca.vertcat(*[retraction] * 3, *[height] * 2, *[retraction] * 2, height),
        states=signals(
            "px [m] body; py [m] body; qx [m] foot; qy [m] foot; theta [rad] leg; r [m] retraction;"
            " dpx [m/s]; dpy [m/s]"
        ),
        inputs=signals("dr [m/s] rate of the retraction; s [m] missing clearance"),
        contacts=signals(
            "z [m] heights of the foot before and after; d1 [m] foot; d2 [m] foot; e1 [rad/s] turn in stance;"
            " e2 [rad/s] turn in stance; f1 [rad/s] swing; f2 [rad/s] swing; u2 [N] thrust"
        ),
        h=h,
        parameters=p,
        referee_model=RefereeModel(),
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw ground, body, leg and goal."""
    body, foot = (float(state[0]), float(state[1])), (float(state[2]), float(state[3]))
    return [Wall(0, 0, 0, 1), Mark(*GOAL[:2], "goal"), Segment(*body, *foot, "actuator"), Circle(*body, 0.1)]
