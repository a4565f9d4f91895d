"""A cart that carries a box by friction only, and shifts the box by braking hard."""

from __future__ import annotations

import casadi as ca
import numpy as np
from pydantic import model_validator

from dynamics.systems import signals, time_stepping
from ocp.problem.problem import Problem, Scaling
from problems.drawing import ContactFrame, Mark, Rectangle, Shape, Wall
from problems.parameters import Parameters, pose_problem, quantity, structure, table
from problems.spec import Citation, Golden

name = "cart-transport"
title = "A cart that carries a box by friction"
citation = Citation("li2026impact", "IMPACT, cart transporter: the model; masses and task are ours")
equations = """
(m_c + m_b) (v_c^+ - v_c) + m_b (v_r^+ - v_r) = h u, quad m_b (v_c^+ - v_c + v_r^+ - v_r) = f
q^+ = q + h v^+, quad abs(f) <= b = "friction" h m_b g, quad abs(r) <= r_"reach"
c "the cart," r "the box's offset on it," f "the impulse of friction"
h v_r^+ = s_f - s_b, quad 0 <= s_f perp b + f >= 0, quad 0 <= s_b perp b - f >= 0
min sum_(k=0)^(N-1) w_u h u_k^2 + w_"end" ((c_N - c_"goal")^2 + (r_N - r_"goal")^2)
  + w_v (v_(c,N)^2 + v_(r,N)^2), quad abs(u) <= u_"max"
"""
golden = {
    "exact": Golden(
        0.592060446, tried=33, independent="all 820 schedules stick, slide forward, stick, each a convex QP"
    )
}


class Params(Parameters):
    """Parameters of ``cart-transport``.

    The published task has mb = 0.1, mc = 0.2, friction = 0.2, reach = 1, h = 0.02 and N = 300, starts and
    ends with the box in the middle (offset0 = goal_offset = 0), and has no bound on the force.
    """

    mc: float = quantity(2.0, "kg", "mass of the cart", above=0)
    mb: float = quantity(1.0, "kg", "mass of the box", above=0)
    g: float = quantity(9.81, "m/s^2", "gravity", above=0)
    friction: float = quantity(0.2, "1", "Coulomb's coefficient between box and cart", above=0)
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(40, "number of steps", least=1)
    reach: float = quantity(0.5, "m", "largest offset at which the box is on the cart", above=0)
    cart0: float = quantity(0.0, "m", "start of the cart")
    offset0: float = quantity(-0.2, "m", "start of the box on the cart")
    goal: float = quantity(1.0, "m", "goal of the cart")
    goal_offset: float = quantity(0.2, "m", "goal of the box on the cart")
    w_u: float = quantity(0.01, "1/(N^2 s)", "stage weight of the force", least=0)
    w_end: float = quantity(100.0, "1/m^2", "terminal weight of the distances", least=0)
    w_v: float = quantity(10.0, "s^2/m^2", "terminal weight of the velocities", least=0)
    u_max: float = quantity(20.0, "N", "largest force on the cart", above=0)

    @model_validator(mode="after")
    def _on_the_cart(self) -> Params:
        for verb, offset in (("starts", self.offset0), ("shall end", self.goal_offset)):
            if abs(offset) > self.reach:
                raise ValueError(
                    f"the box {verb} off the cart: its offset is {offset:g} m, which must lie"
                    f" within reach = {self.reach:g} m of the middle"
                )
        return self


def build(params: Params) -> Problem:
    """Return the problem of cart and box (cart-transport.1), relative to the cart, with friction (cart-transport.4).

    u is a force [N]. Up to |u| = friction g (mc + mb) the box moves with the cart. It slides from one
    end of the cart to the other only if the cart brakes harder.
    """
    p = table(params)
    mc, mb, h = p["mc"], p["mb"], p["h"]
    system = time_stepping(
        name,
        states=signals("c [m] cart; r [m] box on the cart; vc [m/s]; vr [m/s]"),
        inputs=signals("u [N] force on the cart"),
        contacts=signals("cart [N s] friction impulse"),
        h=h,
        mass=ca.vertcat(ca.horzcat(mc + mb, mb), ca.horzcat(mb, mb)),
        impulse=lambda q, v, u: ca.vertcat(h * u, 0),
        sliding=lambda q: ca.SX([[0, 1]]),
        load=mb * p["g"],
        friction=p["friction"],
        parameters=p,
    )
    x, u = system.x, system.u
    squared_error = ca.sumsqr(x[:2] - ca.vertcat(p["goal"], p["goal_offset"]))
    return pose_problem(
        params,
        system,
        stage_cost=p["w_u"] * h * u**2,
        terminal_cost=p["w_end"] * squared_error + p["w_v"] * ca.sumsqr(x[2:]),
        x0=ca.vertcat(p["cart0"], p["offset0"], 0, 0),
        x_lower=ca.vertcat(-ca.inf, -p["reach"], -ca.inf, -ca.inf),
        x_upper=ca.vertcat(ca.inf, p["reach"], ca.inf, ca.inf),
        scaling=Scaling(impulse=0.03, gap=0.02, x=0.5, u=5.0),
    )


CART_HEIGHT = 0.15
"""Height of the cart in the picture [m]."""
BOX_SIDE = 0.15
"""Side of the box in the picture [m]."""


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw floor, cart, box, and the goals of both, which have heights only in the picture."""
    cart, offset = float(state[0]), float(state[1])
    return [
        Wall(0, 0, 0, 1),
        Mark(params.goal, CART_HEIGHT / 2, "goal"),
        Mark(params.goal + params.goal_offset, CART_HEIGHT + BOX_SIDE / 2, "goal"),
        Rectangle(cart, CART_HEIGHT / 2, 2 * params.reach + BOX_SIDE, CART_HEIGHT, role="actuator"),
        Rectangle(cart + offset, CART_HEIGHT + BOX_SIDE / 2, BOX_SIDE, BOX_SIDE),
    ]


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frame of the cart on the box, with Coulomb's coefficient."""
    return [ContactFrame(float(state[0] + state[1]), CART_HEIGHT, 0, 1, params.friction)]
