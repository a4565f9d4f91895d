"""A hopper of one massless leg, whose equations switch between stance and flight."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.systems import ContactSystem, ParameterTable, RefereeModel, signals
from ocp.problem.problem import Constraint, Problem, Scaling
from problems.parameters import Parameters, pose_problem, quantity, structure, table
from problems.spec import Citation

name = "stance-hopper"
title = "Hopper with stance and flight, by vanishing constraints (CRISP)"
citation = Citation("li2025crisp", "CRISP's code, src/examples, 2dHopper")
equations = r"""
m dot(p)_x^+ = m dot(p)_x - h u_2 sin theta, quad m dot(p)_y^+ = m dot(p)_y + h (u_2 cos theta - m g), quad
  p^+ = p + h dot(p)^+
(l_0 - r) cos theta = p_y - q_y, quad (l_0 - r) sin theta = q_x - p_x
q_x^+ = q_x + d, quad q_y^+ = z - q_y, quad theta^+ = theta + h (u_1 + e), quad z, u_2 >= 0
0 <= lambda_1 perp r >= 0, quad abs(d), z, abs(h u_1) <= lambda_1
0 <= lambda_2 perp q_y >= 0, quad abs(h e), u_2 / (m g) <= lambda_2
r <= r_0, quad q_y + r + s >= 0.1, quad s >= 0
min w_"end" norm(x_N - x_"goal")^2 + sum_(k=0)^(N-1) w_1 u_(1,k)^2 + w_2 u_(2,k)^2 + w_s s_k^2
"""
START = (0.0, 1.5, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0)
"""State at the start, in the order of the states [m, rad, m/s]."""
GOAL = (2.0, 1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""State at which the hopper should end [m, rad, m/s]."""
LARGEST_MULTIPLIER = 10.0
"""Upper limit of both multipliers, far above what they bound; without it they could grow at no cost [m, 1]."""


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
    """Return the problem with steps (stance-hopper.1), (stance-hopper.3) and pairs (stance-hopper.4, 5).

    In stance, r > 0, the foot stays on the ground and the leg turns about it; in flight, q_y > 0, the leg has
    its full length and turns at the rate u_1. All that is zero in stance is bounded by one multiplier, lam_1, and all
    that is zero in flight by another, lam_2: the products of the source vanish at the same points, with two pairs
    instead of eight, which would repeat one equation several times. The pair of the last node is left out.
    """
    p = table(params)
    system = _system(p)
    x, u, lam = system.x, system.u, system.lam
    extent = p["l0"] - x[5]
    leg = ca.vertcat(extent * ca.cos(x[4]) - x[1] + x[3], extent * ca.sin(x[4]) - x[2] + x[0])
    in_flight = ca.vertcat(u[2], -u[2], u[3], p["h"] * u[5], -p["h"] * u[5])
    in_stance = ca.vertcat(p["h"] * u[4], -p["h"] * u[4], u[6] / (p["m"] * p["g"]))
    bounded = ca.vertcat(lam[0] - in_flight, lam[1] - in_stance)
    free = -ca.inf
    return pose_problem(
        params,
        system,
        stage_cost=p["w_1"] * u[5] ** 2 + p["w_2"] * u[6] ** 2 + p["w_s"] * u[1] ** 2,
        terminal_cost=p["w_end"] * ca.sumsqr(x - ca.DM(GOAL)),
        x0=ca.DM(START),
        u_lower=ca.SX([free, 0, free, 0, free, free, 0]),
        x_lower=ca.SX([free, free, free, 0, free, 0, free, free]),
        x_upper=ca.vertcat(ca.SX([ca.inf] * 5), p["r0"], ca.SX([ca.inf] * 2)),
        path=[
            Constraint("leg", leg, 0.0, 0.0),
            Constraint("clearance", x[3] + x[5] + u[1] - p["clearance"], 0.0, ca.inf),
            Constraint("phase", bounded, 0.0, ca.inf),
            Constraint("multiplier", lam, free, LARGEST_MULTIPLIER),
        ],
        terminal=[Constraint("leg", leg, 0.0, 0.0)],
        guess=lambda problem, values: hops_in_place(params),
        scaling=Scaling(impulse=1.0, gap=0.5, x=0.5, u=1.0),
    )


def hops_in_place(params: Params) -> tuple[np.ndarray, np.ndarray]:
    """Return states (N+1, 8) and inputs (N, 7) of the source's guess: free fall, with a thrust of 3 m g in stance."""
    height, speed, h = np.zeros(params.N + 1), np.zeros(params.N + 1), params.h
    height[0], weight = START[1], params.m * params.g
    for k in range(params.N):
        thrust = 3 * weight if height[k] < params.l0 else 0.0
        speed[k + 1] = speed[k] + h * (thrust - weight) / params.m
        height[k + 1] = height[k] + h * speed[k + 1]
    retraction, foot = np.maximum(params.l0 - height, 0), np.maximum(height - params.l0, 0)
    zero, thrusts = np.zeros(params.N + 1), np.where(height < params.l0, 3 * weight, 0.0)
    states = np.column_stack([zero, height, zero, foot, zero, retraction, zero, speed])
    missing = np.maximum(params.clearance - foot - retraction, 0)
    inputs = [np.diff(retraction) / h, missing[:-1], zero[1:], foot[:-1] + foot[1:], zero[1:], zero[1:], thrusts[:-1]]
    return states, np.column_stack(inputs)


def _system(p: ParameterTable) -> ContactSystem:
    x, x_next, u, lam = (ca.SX.sym(s, k) for s, k in (("x", 8), ("x_next", 8), ("u", 7), ("lam", 2)))
    h, retraction, height, thrust = p["h"], x[5], x[3], u[6]
    force = ca.vertcat(-thrust * ca.sin(x[4]), thrust * ca.cos(x[4]) - p["m"] * p["g"])
    v_next = x[6:] + h * force / p["m"]
    foot_next, turn = ca.vertcat(x[2] + u[2], u[3] - height), h * (u[4] + u[5])
    return ContactSystem(
        name=name,
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=x_next - ca.vertcat(x[:2] + h * v_next, foot_next, x[4] + turn, retraction + h * u[0], v_next),
        gap=ca.vertcat(retraction, height),
        states=signals(
            "px [m] body; py [m] body; qx [m] foot; qy [m] foot; theta [rad] leg; r [m] retraction;"
            " dpx [m/s]; dpy [m/s]"
        ),
        inputs=signals(
            "dr [m/s] rate of the retraction; s [m] missing clearance; d [m] motion of the foot;"
            " z [m] heights of the foot before and after; e [rad/s] turn in stance; u1 [rad/s] swing; u2 [N] thrust"
        ),
        contacts=signals("flight [m] bound on d, z and h u1; stance [1] bound on h e and u2 over the weight"),
        h=h,
        parameters=p,
        referee_model=RefereeModel(),
    )
