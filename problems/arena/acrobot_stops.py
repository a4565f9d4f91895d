"""An acrobot that swings up, with stops at its elbow."""

from __future__ import annotations

import math
from typing import ClassVar

import casadi as ca
import numpy as np

from dynamics.systems import ContactSystem, ParameterTable, RefereeModel, signals
from ocp.problem.problem import Problem
from problems.arena.midpoint import Midpoint, pose_swing_up, semi_implicit
from problems.arena.published import InstanceParameters, instance_parameters
from problems.drawing import Mark, Segment, Shape
from problems.parameters import quantity, structure, table
from problems.spec import Citation

name = "acrobot-stops"
title = "Acrobot with stops at the elbow (IPDDP2, 100 instances)"
citation = Citation("xu2025ipddp", "InteriorPointDDP.jl, experiments acrobot_contact")
equations = r"""
M(m^+) v^+ - M(m^-) v + h / 2 (b(m^+, v^+) + b(m^-, v)) + h d v^+ = (0, h tau + lambda_2 - lambda_1)
m^plus.minus "= the midpoints," quad m^+ = q + h / 2 v^+, quad m^- = q - h / 2 v, quad q^+ = q + h v^+
M_11 = 2 I + m_2 l_1^2 + 2 a, quad M_12 = M_21 = I + a, quad M_22 = I, quad a = m_2 l_1 l_c cos q_2
b_1 = -m_2 l_1 l_c sin q_2 (2 dot(q)_1 dot(q)_2 + dot(q)_2^2)
  + g (m_1 l_c sin q_1 + m_2 (l_1 sin q_1 + l_c sin(q_1 + q_2)))
b_2 = m_2 l_1 l_c sin q_2 dot(q)_1^2 + g m_2 l_c sin(q_1 + q_2)
0 <= lambda_1 perp pi / 2 - q_2^+ >= 0, quad 0 <= lambda_2 perp pi / 2 + q_2^+ >= 0, quad abs(tau) <= 8
min sum_(k=0)^(N-1) w_u h tau_k^2 + w_"end" norm(q_N - (pi, 0))^2 + w_v norm(v_N)^2
"""
_DRAWN = instance_parameters(name)


class Params(InstanceParameters):
    """Parameters of ``acrobot-stops``; q = 0 hangs at rest."""

    TASK: ClassVar[str] = name

    m1: float = quantity(_DRAWN["m1"], "kg", "mass of the upper link", above=0)
    l1: float = quantity(_DRAWN["l1"], "m", "length of the upper link", above=0)
    m2: float = quantity(_DRAWN["m2"], "kg", "mass of the lower link", above=0)
    l2: float = quantity(_DRAWN["l2"], "m", "length of the lower link, which only the drawing needs", above=0)
    I: float = quantity(0.333, "kg m^2", "inertia of a link about its joint", above=0)  # noqa: E741
    lc: float = quantity(0.5, "m", "distance of a link's centre of mass from its joint", above=0)
    g: float = quantity(9.81, "m/s^2", "gravity", above=0)
    damping: float = quantity(0.5, "N m s/rad", "viscous friction of both joints", least=0)
    stop: float = quantity(math.pi / 2, "rad", "largest angle of the elbow", above=0)
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(100, "number of steps", least=1)
    w_u: float = quantity(0.01, "1/(N^2 m^2 s)", "weight of the torque", least=0)
    w_end: float = quantity(700.0, "1", "terminal weight of the distance to upright", least=0)
    w_v: float = quantity(200.0, "s^2", "terminal weight of the velocities", least=0)
    tau_max: float = quantity(8.0, "N m", "largest torque at the elbow", above=0)


def build(params: Params) -> Problem:
    """Return the problem with steps (acrobot-stops.1), stops (acrobot-stops.6) and cost (acrobot-stops.7).

    Steps are implicit in v+, so that the next velocity of the shoulder is an input, and the balance of
    momentum is a path constraint. The elbow's input is a commanded angle: if the command lies beyond a
    stop, q2 ends at the stop, and lam, the impulse of the stop [N m s], equals the distance beyond the stop [rad].
    """
    p = table(params)
    x, x_next, u, lam = (ca.SX.sym(s, k) for s, k in (("x", 4), ("x_next", 4), ("u", 3), ("lam", 2)))
    q, v, h = x[:2], x[2:], p["h"]
    elbow = u[2] - lam[0] + lam[1]
    v_next = ca.vertcat(u[1], (elbow - q[1]) / h)
    balance = midpoint(p).momentum_change(q, v, v_next) + h * p["damping"] * v_next
    system = ContactSystem(
        name=name,
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=semi_implicit(x, x_next, v_next, h),
        gap=p["stop"] + ca.vertcat(-elbow, elbow),
        states=signals("q1 [rad] shoulder; q2 [rad] elbow; v1 [rad/s]; v2 [rad/s]"),
        inputs=signals("tau [N m] torque at the elbow; w1 [rad/s] next velocity; q2_cmd [rad] commanded elbow"),
        contacts=signals("upper [N m s] impulse of a stop; lower [N m s] impulse of a stop"),
        h=h,
        parameters=p,
        gap_unit="rad",
        referee_model=RefereeModel(),
    )
    balance -= ca.vertcat(0, h * u[0] + lam[1] - lam[0])
    return pose_swing_up(params, system, balance, ca.DM([math.pi, 0]), p["tau_max"])


def midpoint(p: ParameterTable) -> Midpoint:
    """Return the steps of the acrobot with mass matrix (acrobot-stops.3) and bias (acrobot-stops.4, 5)."""
    inertia, coupling, g = p["I"], p["m2"] * p["l1"] * p["lc"], p["g"]

    def mass(q: ca.SX) -> ca.SX:
        a = coupling * ca.cos(q[1])
        return ca.blockcat([[2 * inertia + p["m2"] * p["l1"] ** 2 + 2 * a, inertia + a], [inertia + a, inertia]])

    def bias(q: ca.SX, v: ca.SX) -> ca.SX:
        turning, lower = coupling * ca.sin(q[1]), g * p["m2"] * p["lc"] * ca.sin(q[0] + q[1])
        upper = g * (p["m1"] * p["lc"] + p["m2"] * p["l1"]) * ca.sin(q[0])
        return ca.vertcat(upper + lower - turning * (2 * v[0] * v[1] + v[1] ** 2), lower + turning * v[0] ** 2)

    return Midpoint(mass, bias, p["h"])


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw both links, and the goal of the tip."""
    upper, lower = float(state[0]), float(state[0] + state[1])
    elbow = params.l1 * math.sin(upper), -params.l1 * math.cos(upper)
    tip = elbow[0] + params.l2 * math.sin(lower), elbow[1] - params.l2 * math.cos(lower)
    return [Mark(0, params.l1 + params.l2, "goal"), Segment(0, 0, *elbow, "actuator"), Segment(*elbow, *tip)]
