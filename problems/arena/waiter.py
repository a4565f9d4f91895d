"""A plate that is pulled off a table by the friction of a pusher on its top."""

from __future__ import annotations

import casadi as ca

from dynamics.systems import ContactSystem, RefereeModel, signals
from ocp.problem.problem import Constraint, Problem, Scaling
from problems.arena.midpoint import semi_implicit
from problems.parameters import Parameters, pose_problem, quantity, structure, table
from problems.spec import Citation

name = "waiter"
title = "Pulling a plate off a table by friction (CRISP)"
citation = Citation("li2025crisp", "CRISP's code, src/examples, waiter")
equations = r"""
m_1 a_1 = F - G, quad m_2 a_2 = u - F, quad v^+ = v + h a, quad x^+ = x + h v^+
dot(x)_2 - dot(x)_1 = p - q, quad 0 <= p perp mu_2 n - F >= 0, quad 0 <= q perp mu_2 n + F >= 0
dot(x)_1 = v - w, quad 0 <= v perp mu_1 P - G >= 0, quad 0 <= w perp mu_1 P + G >= 0, quad P = m_1 g - n >= 0
x_2 >= s, quad x_2 - x_1 <= l, quad n (x_2 - x_1 + l) <= m_1 g l, quad n >= 0
min w_"end" norm((x, dot(x))_N - (a, a, b, b))^2 + w_u sum_(k=0)^(N-1) n_k^2 + u_k^2
"""
LARGEST_SLIP = 20.0
"""Upper limit of the parts of slips; a surface without pressure leaves their sum free, which could grow [m/s]."""


class Params(Parameters):
    """Parameters of ``waiter``, with the source's values."""

    m1: float = quantity(2.0, "kg", "mass of the plate", above=0)
    m2: float = quantity(1.0, "kg", "mass of the pusher", above=0)
    l: float = quantity(7.0, "m", "half the length of the plate", above=0)  # noqa: E741
    mu1: float = quantity(0.1, "1", "Coulomb's coefficient between plate and table", above=0)
    mu2: float = quantity(1.0, "1", "Coulomb's coefficient between pusher and plate", above=0)
    g: float = quantity(9.81, "m/s^2", "gravity", above=0)
    s: float = quantity(0.1, "m", "least position of the pusher")
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(99, "number of steps", least=1)
    plate0: float = quantity(-6.0, "m", "start of the plate")
    pusher0: float = quantity(0.1, "m", "start of the pusher")
    x_goal: float = quantity(0.1, "m", "goal of both")
    v_goal: float = quantity(2.0, "m/s", "goal velocity of both")
    w_end: float = quantity(100.0, "1", "terminal weight of every state", least=0)
    w_u: float = quantity(1e-4, "1/N^2", "weight of the forces", least=0)


def build(params: Params) -> Problem:
    """Return the problem with steps (waiter.1), friction (waiter.2), (waiter.3) and cost (waiter.5).

    The friction of a step belongs to the velocities at its start, as in the source. The inputs y are the forces of
    friction without their limits: ``F = y_1 - p + q``, ``G = y_2 - v + w``.
    """
    p = table(params)
    x, x_next, u, lam = (ca.SX.sym(s, k) for s, k in (("x", 4), ("x_next", 4), ("u", 4), ("lam", 4)))
    h, weight, pressure, slip = p["h"], p["m1"] * p["g"], u[1], lam[:2] - lam[2:]
    friction, limits = u[2:] - slip, ca.vertcat(p["mu2"] * pressure, p["mu1"] * (weight - pressure))
    acceleration = ca.vertcat((friction[0] - friction[1]) / p["m1"], (u[0] - friction[0]) / p["m2"])
    v_next = x[2:] + h * acceleration
    system = ContactSystem(
        name=name,
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=semi_implicit(x, x_next, v_next, h),
        gap=ca.vertcat(limits - friction, limits + friction),
        states=signals("x1 [m] plate; x2 [m] pusher; v1 [m/s] plate; v2 [m/s] pusher"),
        inputs=signals(
            "u [N] force on the pusher; n [N] normal force of the pusher;"
            " y1 [N] friction of the pusher without its limit; y2 [N] friction of the table without its limit"
        ),
        contacts=signals("p [m/s] pusher slides forward; v [m/s] plate slides forward; q [m/s] back; w [m/s] back"),
        h=h,
        parameters=p,
        gap_unit="N",
        referee_model=RefereeModel(),
    )
    goal, length = ca.vertcat(p["x_goal"], p["x_goal"], p["v_goal"], p["v_goal"]), p["l"]
    margins = ca.vertcat(x[1] - p["s"], length - x[1] + x[0])
    lever = weight * length - pressure * (x[1] - x[0] + length)
    return pose_problem(
        params,
        system,
        stage_cost=p["w_u"] * ca.sumsqr(u[:2]),
        terminal_cost=p["w_end"] * ca.sumsqr(x - goal),
        x0=ca.vertcat(p["plate0"], p["pusher0"], 0, 0),
        u_lower=ca.vertcat(-ca.inf, 0, -ca.inf, -ca.inf),
        u_upper=ca.vertcat(ca.inf, weight, ca.inf, ca.inf),
        path=[
            Constraint("slip", ca.vertcat(x[3] - x[2], x[2]) - slip, 0.0, 0.0),
            Constraint("speed of sliding", lam, -ca.inf, LARGEST_SLIP),
            Constraint("on the plate", margins, 0.0, ca.inf),
            Constraint("no tipping", lever, 0.0, ca.inf),
        ],
        terminal=[Constraint("on the plate", margins, 0.0, ca.inf)],
        scaling=Scaling(impulse=1.0, gap=1.0, x=1.0, u=5.0),
    )
