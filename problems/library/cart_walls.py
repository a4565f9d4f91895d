"""A pole on a cart between two soft walls, linearised about upright: a linear complementarity system."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.systems import ContactSystem, ParameterTable, RefereeModel, signals
from ocp.problem.problem import Problem, Scaling
from problems.drawing import ContactFrame, Mark, Rectangle, Segment, Shape, Spring
from problems.parameters import Parameters, pose_problem, quantity, structure, table
from problems.spec import Citation, Golden, smoothed

name = "cart-walls"
title = "A pole on a cart between soft walls"
citation = Citation("zhang2023adaptive", "A linear complementarity system as in eq. 2.1-2.2")
equations = """
x = (p, theta, dot(p), dot(theta)), quad x^+ = x + h (A x^+ + B u + C lambda)
A_13 = A_24 = 1, quad A_32 = g m_p / m_c, quad A_42 = g (m_c + m_p) / (l m_c)
B = (0, 0, 1 / m_c, 1 / (l m_c)), quad C_4 = (-1 / (l m_p), 1 / (l m_p)), quad lambda "forces"
0 <= lambda_1 perp lambda_1 / k + d - (p^+ + l theta^+) >= 0, quad
  0 <= lambda_2 perp lambda_2 / k + d + (p^+ + l theta^+) >= 0
min sum_(k=0)^(N-1) w_p p^2 + w_theta theta^2 + w_(dot(p)) dot(p)^2
  + w_(dot(theta)) dot(theta)^2 + w_u u^2 + w_"end" norm(x_N)^2
abs(u) <= u_"max", quad "from" (p_0, theta_0, dot(p)_0, dot(theta)_0)
"""
golden = {
    "exact": Golden(
        186.588555,
        tried=33,
        independent="all 2550 windows of contact with one wall, each a convex QP",
        note="a plain Opti script, cold Scholtes homotopy, ends no lower from 36 random guesses;"
        " other minima: 193.17, 562.3",
    ),
    "barrier mu=1e-3": smoothed(
        184.91946, tried=11, note="a plain Opti script ends no lower from 18 random guesses; one at 3285"
    ),
}


class Params(Parameters):
    """Parameters of ``cart-walls``; the walls are springs that the tip of the pole can touch."""

    mc: float = quantity(1.0, "kg", "mass of the cart", above=0)
    mp: float = quantity(0.1, "kg", "mass of the pole's tip", above=0)
    l: float = quantity(0.5, "m", "length of the pole", above=0)  # noqa: E741
    g: float = quantity(9.81, "m/s^2", "gravity")
    wall: float = quantity(0.35, "m", "distance of either wall from the middle", above=0)
    k: float = quantity(100.0, "N/m", "stiffness of the walls", above=0)
    h: float = quantity(0.04, "s", "step size", above=0)
    N: int = structure(50, "number of steps", least=1)
    p0: float = quantity(0.1, "m", "start of the cart")
    theta0: float = quantity(0.2, "rad", "start angle of the pole")
    dp0: float = quantity(0.5, "m/s", "start velocity of the cart")
    dtheta0: float = quantity(2.0, "rad/s", "start angular velocity of the pole")
    w_p: float = quantity(10.0, "1/m^2", "stage weight of the cart's position", least=0)
    w_theta: float = quantity(50.0, "1/rad^2", "stage weight of the angle", least=0)
    w_dp: float = quantity(1.0, "s^2/m^2", "stage weight of the cart's velocity", least=0)
    w_dtheta: float = quantity(5.0, "s^2/rad^2", "stage weight of the angular velocity", least=0)
    w_u: float = quantity(0.1, "1/N^2", "stage weight of the force", least=0)
    w_end: float = quantity(100.0, "SI", "terminal weight of every state", least=0)
    u_max: float = quantity(4.0, "N", "largest force on the cart", above=0)


def build(params: Params) -> Problem:
    """Return the problem with implicit Euler steps (cart-walls.1) about upright; u and lam are forces [N].

    The system has no signed distance to audit, since the walls are compliant and the tip may enter them.
    Only the gap, which includes the deflection of the wall's spring, must not be negative.
    """
    p = table(params)
    system = _system(p)
    x, u = system.x, system.u
    weights = ca.vertcat(p["w_p"], p["w_theta"], p["w_dp"], p["w_dtheta"])
    return pose_problem(
        params,
        system,
        stage_cost=ca.dot(weights, x**2) + p["w_u"] * u**2,
        terminal_cost=p["w_end"] * ca.sumsqr(x),
        x0=ca.vertcat(p["p0"], p["theta0"], p["dp0"], p["dtheta0"]),
        scaling=Scaling(impulse=10.0, gap=0.01, x=0.2, u=2.0),
    )


def _system(p: ParameterTable) -> ContactSystem:
    x, x_next = ca.SX.sym("x", 4), ca.SX.sym("x_next", 4)
    u, lam = ca.SX.sym("u"), ca.SX.sym("lam", 2)
    mc, mp, length = p["mc"], p["mp"], p["l"]
    _, theta, dp, dtheta = ca.vertsplit(x_next)
    acceleration = p["g"] * mp / mc * theta + u / mc
    angular_acceleration = (
        p["g"] * (mc + mp) / (length * mc) * theta + u / (length * mc) + (lam[1] - lam[0]) / (length * mp)
    )
    tip = x_next[0] + length * theta
    return ContactSystem(
        name=name,
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=x_next - x - p["h"] * ca.vertcat(dp, dtheta, acceleration, angular_acceleration),
        gap=lam / p["k"] + p["wall"] + ca.vertcat(-tip, tip),
        states=signals("p [m] cart; theta [rad] pole; dp [m/s]; dtheta [rad/s]"),
        inputs=signals("u [N] force on the cart"),
        contacts=signals("right [N] force of the right wall; left [N] force of the left wall"),
        h=p["h"],
        parameters=p,
        # The gap of a spring is exact, so that the referee needs no other gap.
        referee_model=RefereeModel(),
        refinable=True,
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw cart, pole and tip, and the springs of both walls at the height of the tip."""
    return pole_shapes(float(state[0]), *_tip(params, state), params.wall)


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frames of the right wall, which pushes the tip to the left, and of the left wall."""
    return pole_frames(*_tip(params, state))


def _tip(params: Params, state: np.ndarray) -> tuple[float, float]:
    return float(state[0]) + params.l * float(state[1]), params.l


def pole_shapes(position: float, tip: float, height: float, wall: float) -> list[Shape]:
    """Draw a cart at ``position``, a pole with its ``tip`` at a ``height``, and the walls' springs.

    The picture is linear in the angle, as the model is, so that it shows contact where the model does.
    """
    return [
        Rectangle(position, -0.05, 0.2, 0.1, role="actuator"),
        Segment(position, 0, tip, height),
        Mark(tip, height),
        Spring(wall + 0.15, height, max(wall, tip), height),
        Spring(-wall - 0.15, height, min(-wall, tip), height),
    ]


def pole_frames(tip: float, height: float) -> list[ContactFrame]:
    """Return the contact frames at the tip, of the right wall and of the left wall."""
    return [ContactFrame(tip, height, -1, 0), ContactFrame(tip, height, 1, 0)]
