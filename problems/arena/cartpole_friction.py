"""A pole that swings up on a cart, with dry friction at the cart and in the joint."""

from __future__ import annotations

import math
from typing import ClassVar

import casadi as ca
import numpy as np

from dynamics.systems import ContactSystem, ParameterTable, RefereeModel, signals
from ocp.problem.problem import Problem
from problems.arena.midpoint import Midpoint, pose_swing_up, semi_implicit
from problems.arena.published import InstanceParameters, instance_parameters
from problems.drawing import Mark, Rectangle, Segment, Shape
from problems.parameters import quantity, structure, table
from problems.spec import Citation

name = "cartpole-friction"
title = "Cart-pole with dry friction in both joints (IPDDP2, 100 instances)"
citation = Citation("xu2025ipddp", "InteriorPointDDP.jl, experiments cartpole_friction")
equations = r"""
M(m^+) v^+ - M(m^-) v + h / 2 (b(m^+, v^+) + b(m^-, v)) = h ((F, 0) + f)
m^plus.minus "= the midpoints," quad m^+ = q + h / 2 v^+, quad m^- = q - h / 2 v, quad q^+ = q + h v^+
M_11 = m_c + m_p, quad M_12 = M_21 = m_p l cos theta, quad M_22 = m_p l^2
b = (-m_p l dot(theta)^2 sin theta, m_p g l sin theta)
v_i^+ = c_i - a_i, quad 0 <= a_i perp gamma_i - f_i >= 0, quad 0 <= c_i perp gamma_i + f_i >= 0
gamma_1 = f_1 (m_c + m_p) g, quad gamma_2 = f_2 m_p g l, quad abs(F) <= F_"max"
min sum_(k=0)^(N-1) w_u h F_k^2 + w_"end" norm(q_N - (0, pi))^2 + w_v norm(v_N)^2
"""
_DRAWN = instance_parameters(name)


class Params(InstanceParameters):
    """Parameters of ``cartpole-friction``; the pole hangs at rest at theta = 0."""

    TASK: ClassVar[str] = name

    mc: float = quantity(_DRAWN["mc"], "kg", "mass of the cart", above=0)
    mp: float = quantity(_DRAWN["mp"], "kg", "mass of the pole's tip", above=0)
    l: float = quantity(_DRAWN["l"], "m", "length of the pole", above=0)  # noqa: E741
    f1: float = quantity(_DRAWN["f1"], "1", "coefficient of friction of the cart", above=0)
    f2: float = quantity(_DRAWN["f2"], "1", "coefficient of friction of the joint", above=0)
    g: float = quantity(9.81, "m/s^2", "gravity", above=0)
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(100, "number of steps", least=1)
    w_u: float = quantity(0.01, "1/(N^2 s)", "weight of the force", least=0)
    w_end: float = quantity(700.0, "1", "terminal weight of the distance to upright", least=0)
    w_v: float = quantity(200.0, "s^2", "terminal weight of the velocities", least=0)
    F_max: float = quantity(10.0, "N", "largest force on the cart", above=0)


def build(params: Params) -> Problem:
    """Return the problem with steps (cartpole-friction.1), friction (cartpole-friction.5) and its cost.

    lam are the parts a, c of the next velocities. An input y_i is the friction f_i without its limit, and
    ``f_i = y_i - a_i + c_i``: the amount [N] by which y_i exceeds the limit equals the
    sliding velocity [m/s]. The balance of momentum, implicit in v+, is a path constraint on the inputs.
    """
    p = table(params)
    x, x_next, u, lam = (ca.SX.sym(s, k) for s, k in (("x", 4), ("x_next", 4), ("u", 3), ("lam", 4)))
    q, v, h, m = x[:2], x[2:], p["h"], p["mp"]
    v_next = lam[2:] - lam[:2]
    friction, limit = u[1:] + v_next, p["g"] * ca.vertcat(p["f1"] * (p["mc"] + m), p["f2"] * m * p["l"])
    balance = midpoint(p).momentum_change(q, v, v_next) - h * (ca.vertcat(u[0], 0) + friction)
    system = ContactSystem(
        name=name,
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=semi_implicit(x, x_next, v_next, h),
        gap=ca.vertcat(limit - friction, limit + friction),
        states=signals("p [m] cart; theta [rad] pole, anticlockwise; dp [m/s]; dtheta [rad/s]"),
        inputs=signals("F [N] force on the cart; y1 [N] friction without limit; y2 [N m] friction without limit"),
        contacts=signals("back [m/s] cart; down [rad/s] pole; forth [m/s] cart; up [rad/s] pole"),
        h=h,
        parameters=p,
        gap_unit="N",
        referee_model=RefereeModel(),
    )
    return pose_swing_up(params, system, balance, ca.DM([0, math.pi]), p["F_max"])


def midpoint(p: ParameterTable) -> Midpoint:
    """Return the steps of cart and pole with mass matrix (cartpole-friction.3) and bias (cartpole-friction.4)."""
    m, length = p["mp"], p["l"]

    def mass(q: ca.SX) -> ca.SX:
        coupling = m * length * ca.cos(q[1])
        return ca.blockcat([[p["mc"] + m, coupling], [coupling, m * length**2]])

    def bias(q: ca.SX, v: ca.SX) -> ca.SX:
        return m * length * ca.sin(q[1]) * ca.vertcat(-(v[1] ** 2), p["g"])

    return Midpoint(mass, bias, p["h"])


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw cart, pole and the goal of its tip."""
    cart, angle = float(state[0]), float(state[1])
    tip = cart + params.l * math.sin(angle), -params.l * math.cos(angle)
    pole = Segment(cart, 0, *tip)
    return [Mark(0, params.l, "goal"), Rectangle(cart, 0, 0.2, 0.1, role="actuator"), pole, Mark(*tip)]
