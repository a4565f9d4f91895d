"""A pole on a cart that swings up between two soft walls, which it may push off."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from dynamics.systems import ContactSystem, RefereeModel, signals
from ocp.problem.problem import Problem, Scaling
from problems.arena.midpoint import semi_implicit
from problems.drawing import Mark, Rectangle, Segment, Shape, Spring
from problems.parameters import Parameters, pose_problem, quantity, structure, table
from problems.spec import Citation

name = "pushbot"
title = "Cart-pole swing-up between soft walls (CRISP)"
citation = Citation("li2025crisp", "CRISP's code, src/examples/pushbot")
equations = r"""
(m_c + m_p sin(theta)^2) a_p = F cos(theta)^2 - F + u - g m_p cos theta sin theta
  + l m_p dot(theta)^2 sin theta, quad F = lambda_1 - lambda_2
l m_p (m_c + m_p sin(theta)^2) a_theta = g m_p (m_p + m_c) sin theta - F m_c cos theta
  - m_p u cos theta - l m_p^2 dot(theta)^2 cos theta sin theta
q^+ = q + h v^+, quad v^+ = v + h a
0 <= lambda_1 perp d - s + lambda_1 / k >= 0, quad 0 <= lambda_2 perp d + s + lambda_2 / k >= 0, quad
  s = p + l sin theta
min w_"end" norm(x_N)^2 + w_u sum_(k=0)^(N-1) u_k^2
"""


class Params(Parameters):
    """Parameters of ``pushbot``; the pole is upright at theta = 0."""

    mc: float = quantity(1.0, "kg", "mass of the cart", above=0)
    mp: float = quantity(0.1, "kg", "mass of the pole's tip", above=0)
    l: float = quantity(0.8, "m", "length of the pole", above=0)  # noqa: E741
    g: float = quantity(9.8, "m/s^2", "gravity", above=0)
    wall: float = quantity(1.0, "m", "distance of either wall from the middle", above=0)
    k: float = quantity(200.0, "N/m", "stiffness of the walls", above=0)
    h: float = quantity(0.02, "s", "step size", above=0)
    N: int = structure(99, "number of steps", least=1)
    theta0: float = quantity(3.14159, "rad", "start angle of the pole")
    dtheta0: float = quantity(2.8, "rad/s", "start rate of the pole")
    w_end: float = quantity(100.0, "1", "terminal weight of every state", least=0)
    w_u: float = quantity(1e-3, "1/N^2", "weight of the force", least=0)


def build(params: Params) -> Problem:
    """Return the problem with accelerations (pushbot.1), (pushbot.2), walls (pushbot.4) and cost (pushbot.5).

    The forces of the walls depend on the state from which a step starts. u and lam are forces [N].
    """
    p = table(params)
    x, x_next, u, lam = (ca.SX.sym(s, k) for s, k in (("x", 4), ("x_next", 4), ("u", 1), ("lam", 2)))
    mc, mp, length, g, h = (p[key] for key in ("mc", "mp", "l", "g", "h"))
    cart, angle, dp, rate = ca.vertsplit(x)
    sin, cos, push = ca.sin(angle), ca.cos(angle), lam[0] - lam[1]
    inertia = mc + mp * sin**2
    centrifugal = length * mp * rate**2 * sin
    cart_rate = (push * (cos**2 - 1) + u - g * mp * cos * sin + centrifugal) / inertia
    moment = g * mp * (mp + mc) * sin - push * mc * cos - mp * u * cos - mp * centrifugal * cos
    v_next = ca.vertcat(dp + h * cart_rate, rate + h * moment / (length * mp * inertia))
    tip = cart + length * sin
    system = ContactSystem(
        name=name,
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=semi_implicit(x, x_next, v_next, h),
        gap=p["wall"] + lam / p["k"] + ca.vertcat(-tip, tip),
        states=signals("p [m] cart; theta [rad] pole from upright; dp [m/s]; dtheta [rad/s]"),
        inputs=signals("u [N] force on the cart"),
        contacts=signals("right [N] force of the right wall; left [N] force of the left wall"),
        h=h,
        parameters=p,
        # The gap of a spring is exact, so that the referee needs no other gap.
        referee_model=RefereeModel(),
        refinable=True,
    )
    return pose_problem(
        params,
        system,
        stage_cost=p["w_u"] * u**2,
        terminal_cost=p["w_end"] * ca.sumsqr(x),
        x0=ca.vertcat(0, p["theta0"], 0, p["dtheta0"]),
        scaling=Scaling(impulse=10.0, gap=0.1, x=1.0, u=10.0),
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw cart, pole and tip, and the springs of both walls at the height of the tip."""
    cart, height = float(state[0]), params.l * math.cos(float(state[1]))
    tip, wall = cart + params.l * math.sin(float(state[1])), params.wall
    return [
        Rectangle(cart, 0, 0.3, 0.1, role="actuator"),
        Segment(cart, 0, tip, height),
        Mark(tip, height),
        Spring(wall + 0.15, height, max(wall, tip), height),
        Spring(-wall - 0.15, height, min(-wall, tip), height),
    ]
