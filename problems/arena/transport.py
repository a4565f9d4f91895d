"""A cargo that a cart carries by dry friction alone, from one motion to another."""

from __future__ import annotations

import casadi as ca

from dynamics.systems import ContactSystem, RefereeModel, signals
from ocp.problem.problem import Constraint, Problem, Scaling
from problems.arena.midpoint import semi_implicit
from problems.parameters import Parameters, pose_problem, quantity, structure, table
from problems.spec import Citation

name = "transport"
title = "Payload on a cart (CRISP)"
citation = Citation("li2025crisp", "CRISP's code, src/examples, Transp")
equations = r"""
m_1 a_1 = f, quad m_2 a_2 = u - f, quad v^+ = v + h a, quad x^+ = x + h v^+
dot(x)_1 - dot(x)_2 = v - w, quad 0 <= v perp f + b >= 0, quad 0 <= w perp b - f >= 0, quad b = mu m_1 g
abs(x_1 - x_2) <= l
min w_x norm(x_N - x_"goal")^2 + w_v norm(dot(x)_N - dot(x)_"goal")^2 + w_u sum_(k=0)^(N-1) f_k^2 + u_k^2
"""


class Params(Parameters):
    """Parameters of ``transport``, with the source's values."""

    m1: float = quantity(1.0, "kg", "mass of the cargo", above=0)
    m2: float = quantity(2.0, "kg", "mass of the cart", above=0)
    friction: float = quantity(0.2, "1", "Coulomb's coefficient between cargo and cart", above=0)
    g: float = quantity(9.81, "m/s^2", "gravity", above=0)
    l: float = quantity(1.0, "m", "half the length of the cart", above=0)  # noqa: E741
    h: float = quantity(0.02, "s", "step size", above=0)
    N: int = structure(199, "number of steps", least=1)
    cargo0: float = quantity(3.5, "m", "start of the cargo")
    cart0: float = quantity(3.0, "m", "start of the cart")
    v0: float = quantity(-4.0, "m/s", "start velocity of both")
    cargo_goal: float = quantity(-0.5, "m", "goal of the cargo")
    cart_goal: float = quantity(0.0, "m", "goal of the cart")
    v_goal: float = quantity(-2.0, "m/s", "goal velocity of both")
    w_x: float = quantity(1e5, "1/m^2", "terminal weight of the positions", least=0)
    w_v: float = quantity(10.0, "s^2/m^2", "terminal weight of the velocities", least=0)
    w_u: float = quantity(1e-4, "1/N^2", "weight of the forces", least=0)


def build(params: Params) -> Problem:
    """Return the problem with steps (transport.1), friction (transport.2) and cost (transport.4).

    The friction of a step belongs to the velocities at its start, as in the source. The input y is the friction
    without its limit, ``f = y + v - w``: the amount [N] by which y exceeds the limit equals the
    sliding velocity [m/s].
    """
    p = table(params)
    x, x_next, u, lam = (ca.SX.sym(s, k) for s, k in (("x", 4), ("x_next", 4), ("u", 2), ("lam", 2)))
    h, friction, limit = p["h"], u[1] + lam[0] - lam[1], p["friction"] * p["m1"] * p["g"]
    v_next = x[2:] + h * ca.vertcat(friction / p["m1"], (u[0] - friction) / p["m2"])
    system = ContactSystem(
        name=name,
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=semi_implicit(x, x_next, v_next, h),
        gap=ca.vertcat(limit + friction, limit - friction),
        states=signals("x1 [m] cargo; x2 [m] cart; v1 [m/s] cargo; v2 [m/s] cart"),
        inputs=signals("u [N] force on the cart; y [N] friction without its limit"),
        contacts=signals("v [m/s] cargo slides forward on the cart; w [m/s] cargo slides back"),
        h=h,
        parameters=p,
        gap_unit="N",
        referee_model=RefereeModel(),
    )
    goal, final_velocity = ca.vertcat(p["cargo_goal"], p["cart_goal"]), p["v_goal"]
    on_the_cart = Constraint("on the cart", x[0] - x[1], -p["l"], p["l"])
    return pose_problem(
        params,
        system,
        stage_cost=p["w_u"] * (u[0] ** 2 + friction**2),
        terminal_cost=p["w_x"] * ca.sumsqr(x[:2] - goal) + p["w_v"] * ca.sumsqr(x[2:] - final_velocity),
        x0=ca.vertcat(p["cargo0"], p["cart0"], p["v0"], p["v0"]),
        path=[Constraint("slip", x[2] - x[3] - lam[0] + lam[1], 0.0, 0.0), on_the_cart],
        terminal=[on_the_cart],
        scaling=Scaling(impulse=1.0, gap=1.0, x=1.0, u=5.0),
    )
