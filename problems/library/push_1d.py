"""A mass on a line, pushed by an actuator that a spring holds at its command."""

from __future__ import annotations

import casadi as ca
import numpy as np
from pydantic import model_validator

from dynamics.learned.region import Region
from dynamics.systems import quasi_dynamic, signals
from ocp.problem.problem import Problem, Scaling
from problems.drawing import ContactFrame, Mark, Rectangle, Shape
from problems.parameters import Parameters, pose_problem, quantity, structure, table
from problems.spec import Citation, Golden, smoothed

name = "push-1d"
title = "Pushing a mass along a line"
citation = Citation("suh2023noising", "Noising data, sec. IV-B and eq. 13")
axes = ("x [m]", "")
equations = """
M / h (q_u^+ - q_u) = lambda, quad h K (q_a^+ - u) = -lambda, quad
  0 <= lambda perp q_u^+ - q_a^+ - "width" >= 0
min sum_(k=0)^(N-1) w_x (q_(u,k) - x_"goal")^2 + w_(delta u) delta u_k^2
  + w_"end" (q_(u,N) - x_"goal")^2
delta u_k = u_k - u_(k-1), quad u_(-1) = q_(a,0), quad abs(u) <= u_"max"
"""
golden = {
    "exact": Golden(1.38481827, tried=33, independent="all 210 windows of contact, each a convex QP"),
    "barrier mu=1e-3": smoothed(1.3869158, tried=11, note="a plain Opti script ends no lower from 18 random guesses"),
}


class Params(Parameters):
    """Parameters of ``push-1d``; qu is the object, and qa is the pusher on its left."""

    M: float = quantity(1.0, "kg", "mass of the object", above=0)
    K: float = quantity(100.0, "N/m", "stiffness of the actuator", above=0)
    h: float = quantity(0.1, "s", "step size", above=0)
    N: int = structure(20, "number of steps", least=1)
    width: float = quantity(0.2, "m", "distance of the centres in contact", least=0)
    qu0: float = quantity(0.0, "m", "start of the object")
    qa0: float = quantity(-0.5, "m", "start of the pusher")
    goal_x: float = quantity(1.0, "m", "goal of the object")
    w_x: float = quantity(1.0, "1/m^2", "stage weight of the distance to the goal", least=0)
    w_du: float = quantity(0.1, "1/m^2", "stage weight of the input's increments", least=0)
    w_end: float = quantity(100.0, "1/m^2", "terminal weight of the distance to the goal", least=0)
    u_max: float = quantity(2.0, "m", "largest commanded position", above=0)

    @model_validator(mode="after")
    def _apart(self) -> Params:
        if self.qu0 - self.qa0 < self.width:
            raise ValueError(
                f"the pusher starts inside the object: qu0 - qa0 = {self.qu0 - self.qa0:g} m must"
                f" be at least width = {self.width:g} m"
            )
        return self


def build(params: Params) -> Problem:
    """Return the problem with steps (push-1d.1) of Suh et al. (2023), sec. IV-B; u is in m, lam in N s."""
    p = table(params)
    system = quasi_dynamic(
        name,
        states=signals("qu [m] object; qa [m] pusher"),
        inputs=signals("u [m] commanded pusher"),
        contacts=signals("push [N s] impulse on the object"),
        h=p["h"],
        mass=p["M"],
        stiffness=p["K"],
        distance=lambda q: q[0] - q[1] - p["width"],
        parameters=p,
    )
    du = ca.SX.sym("du", 1)
    error = system.x[0] - p["goal_x"]
    return pose_problem(
        params,
        system,
        stage_cost=p["w_x"] * error**2 + p["w_du"] * du**2,
        terminal_cost=p["w_end"] * error**2,
        x0=ca.vertcat(p["qu0"], p["qa0"]),
        du=du,
        u_before=p["qa0"],
        scaling=Scaling(impulse=0.5, gap=0.1, x=0.5, u=0.5),
    )


def region(params: Params) -> Region:
    """Return the region of sampled transitions: 0.5 m around a line on which pusher and object move together."""
    low, high = sorted((params.qu0, params.goal_x))
    pusher = params.qa0 + params.goal_x - params.qu0
    behind, front = min(params.qa0, pusher), max(params.qa0, pusher)
    return Region(
        {"qu": (low - 0.5, high + 0.5), "qa": (behind - 0.5, front + 0.5)},
        {"u": (-0.5, 0.5)},
        (params.qu0, params.qa0),
        (params.goal_x, pusher),
        spread=(0.2, 0.2),
        around={"u": "qa"},
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw object and pusher as boxes that touch at distance ``width``, and the goal."""
    side = params.width or 0.05
    return [
        Mark(params.goal_x, 0, "goal"),
        Rectangle(float(state[0]), 0, side, side),
        Rectangle(float(state[1]), 0, side, side, role="actuator"),
    ]


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frame of the pusher on the object's left face."""
    return [ContactFrame(float(state[0]) - params.width / 2, 0, 1, 0)]
