"""A pole on a cart between soft walls over a short horizon; the terminal cost is a linear regulator's cost-to-go."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from dynamics.systems import RefereeModel, lcs, signals
from ocp.problem.problem import Problem, Scaling
from problems.drawing import ContactFrame, Shape
from problems.library.cart_walls import pole_frames, pole_shapes
from problems.parameters import Parameters, pose_problem, quantity, structure, table
from problems.spec import Citation, Golden

name = "soft-walls"
title = "A pole balanced between soft walls, over a short horizon"
citation = Citation("aydinoglu2024c3", "C3's cart-pole; its code, c3_cartpole_problem.hpp")
equations = r"""
x = (p, theta, dot(p), dot(theta)), quad x^+ = x + h (A x + B u + C lambda), quad
  A_13 = A_24 = 1, quad A_32 = g m_p / m_c, quad A_42 = g (m_c + m_p) / (l_c m_c)
B = (0, 0, 1 / m_c, 1 / (l_c m_c)), quad C_3 = (c_p, -c_p), quad C_4 = (c_theta, -c_theta), quad
  c_p = (l_p / l_c - 1) / m_c, quad
  c_theta = l_p (m_c + m_p) / (m_c m_p l_c^2) - 1 / (m_c l_c)
0 <= lambda_1 perp lambda_1 / k + d - (p - l_p theta) >= 0, quad
  0 <= lambda_2 perp lambda_2 / k + d + (p - l_p theta) >= 0
min x_N^top P x_N + sum_(k=0)^(N-1) x_k^top Q x_k + w_u u_k^2
P = Q + A_d^top P (A_d - B_d K), quad K = B_d^top P A_d \/ (w_u + B_d^top P B_d), quad
  A_d = I + h A, quad B_d = h B, quad Q "diagonal"
"""
golden = {
    "exact": Golden(
        361.3236972, tried=21, independent="all 210 windows of contact with the right wall, each a convex QP"
    )
}

_DOUBLINGS = 14
"""Number of doublings; the error is r^(2^15) if the slowest mode of the closed loop decays by r per step."""


class Params(Parameters):
    """Parameters of ``soft-walls`` with the source's values, except N, which is 5 in the source."""

    mc: float = quantity(0.978, "kg", "mass of the cart", above=0)
    mp: float = quantity(0.411, "kg", "mass of the pole", above=0)
    lp: float = quantity(0.6, "m", "from the pole's joint to its tip, which touches", above=0)
    lc: float = quantity(0.4267, "m", "from the pole's joint to its centre of mass", above=0)
    g: float = quantity(9.81, "m/s^2", "gravity")
    wall: float = quantity(0.35, "m", "distance of either wall from the middle", above=0)
    k: float = quantity(100.0, "N/m", "stiffness of the walls", above=0)
    h: float = quantity(0.01, "s", "step size", above=0)
    N: int = structure(20, "number of steps", least=1)
    p0: float = quantity(0.1, "m", "start of the cart")
    theta0: float = quantity(-0.5, "rad", "start angle of the pole, anticlockwise")
    dp0: float = quantity(0.5, "m/s", "start velocity of the cart")
    dtheta0: float = quantity(-0.4, "rad/s", "start angular velocity of the pole")
    w_p: float = quantity(10.0, "1/m^2", "stage weight of the cart's position", above=0)
    w_theta: float = quantity(2.0, "1/rad^2", "stage weight of the angle", least=0)
    w_dp: float = quantity(1.0, "s^2/m^2", "stage weight of the cart's velocity", least=0)
    w_dtheta: float = quantity(1.0, "s^2/rad^2", "stage weight of the angular velocity", least=0)
    w_u: float = quantity(1.0, "1/N^2", "stage weight of the force", above=0)


def build(params: Params) -> Problem:
    """Return the problem with explicit Euler steps (soft-walls.1), (soft-walls.2) about upright; u, lam are forces [N].

    The walls' forces (soft-walls.3) depend on the state at the start of a step, so that the input affects them one
    step later. Without walls the optimum of (soft-walls.4) is the regulator's optimum for any N.
    """
    p = table(params)
    h, mc, mp, lp, lc = (p[key] for key in ("h", "mc", "mp", "lp", "lc"))
    A, B, C = ca.SX.eye(4), ca.SX.zeros(4), ca.SX.zeros(4)
    A[0, 2] = A[1, 3] = h
    A[2, 1], A[3, 1] = h * p["g"] * mp / mc, h * p["g"] * (mc + mp) / (lc * mc)
    B[2], B[3] = h / mc, h / (lc * mc)
    C[2] = h * (lp / lc - 1) / mc
    C[3] = h * (lp * (mc + mp) / (mc * mp * lc**2) - 1 / (mc * lc))
    tip = ca.horzcat(1, -lp, 0, 0)
    system = lcs(
        name,
        A=A,
        B=B,
        C=ca.horzcat(C, -C),
        D=ca.vertcat(-tip, tip),
        E=ca.SX(2, 1),
        F=ca.SX.eye(2) / p["k"],
        d=ca.vertcat(p["wall"], p["wall"]),
        h=h,
        parameters=p,
        states=signals("p [m] cart; theta [rad] pole, anticlockwise; dp [m/s]; dtheta [rad/s]"),
        inputs=signals("u [N] force on the cart"),
        contacts=signals("right [N] force of the right wall; left [N] force of the left wall"),
    )
    x, Q = system.x, ca.diag(ca.vertcat(p["w_p"], p["w_theta"], p["w_dp"], p["w_dtheta"]))
    return pose_problem(
        params,
        # The gap of a spring is exact, so that the referee needs no other gap.
        replace(system, gap_unit="m", referee_model=RefereeModel(), refinable=True),
        stage_cost=ca.bilin(Q, x) + p["w_u"] * system.u**2,
        terminal_cost=ca.bilin(cost_to_go(A, B, Q, p["w_u"]), x),
        x0=ca.vertcat(p["p0"], p["theta0"], p["dp0"], p["dtheta0"]),
        scaling=Scaling(impulse=5.0, gap=0.05, x=0.3, u=5.0),
    )


def cost_to_go(A: ca.SX, B: ca.SX, Q: ca.SX, R: ca.SX) -> ca.SX:
    """Return the solution P (n, n) of the discrete Riccati equation (soft-walls.5), an expression in A, B, Q and R.

    The method is structure-preserving doubling, which converges quadratically: Chu, Fan and Lin, "A
    structure-preserving doubling algorithm for continuous-time algebraic Riccati equations", 2005.
    """
    G, P, eye = B @ ca.solve(R, B.T), Q, ca.SX.eye(A.shape[0])
    for _ in range(_DOUBLINGS):
        closed = ca.inv(eye + G @ P)
        A, G, P = A @ closed @ A, G + A @ closed @ G @ A.T, P + A.T @ P @ closed @ A
    return (P + P.T) / 2


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw cart, pole and tip, and the springs of both walls at the height of the tip."""
    tip = float(state[0]) - params.lp * float(state[1])
    return pole_shapes(float(state[0]), tip, params.lp, params.wall)


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frames of the right wall, which pushes the tip to the left, and of the left wall."""
    return pole_frames(float(state[0]) - params.lp * float(state[1]), params.lp)
