"""A box pushed along a rough floor to a goal, where friction stops it."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.systems import signals, time_stepping
from ocp.problem.problem import Problem, Scaling
from problems.drawing import ContactFrame, Mark, Rectangle, Shape, Wall
from problems.parameters import Parameters, pose_problem, quantity, structure, table
from problems.spec import Citation, Golden

name = "box-slide"
title = "A box pushed over a rough floor"
citation = Citation("zhang2023adaptive", "Adaptive barrier smoothing, fig. 6b, as a task")
equations = """
m (v^+ - v) = h u + f, quad x^+ = x + h v^+, quad abs(f) <= b = "friction" h m g
h v^+ = s_f - s_b, quad 0 <= s_f perp b + f >= 0, quad 0 <= s_b perp b - f >= 0
"sliding forward" f = -b, quad "sliding backward" f = b, quad "at rest" f "is what holds the box"
min sum_(k=0)^(N-1) w_u h u_k^2 + w_"end" (x_N - x_"goal")^2 + w_v v_N^2, quad abs(u) <= u_"max"
"""
golden = {"exact": Golden(0.354703374, tried=33, independent="all 820 schedules stick, slide, stick, each a convex QP")}


class Params(Parameters):
    """Parameters of ``box-slide``; default mass, friction and step are those of the workbench's figure A6."""

    m: float = quantity(1.0, "kg", "mass of the box", above=0)
    g: float = quantity(9.81, "m/s^2", "gravity", above=0)
    friction: float = quantity(0.5, "1", "Coulomb's coefficient", above=0)
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(40, "number of steps", least=1)
    x0: float = quantity(0.0, "m", "start")
    v0: float = quantity(0.0, "m/s", "start velocity")
    goal: float = quantity(1.0, "m", "goal")
    w_u: float = quantity(0.01, "1/(N^2 s)", "stage weight of the push", least=0)
    w_end: float = quantity(100.0, "1/m^2", "terminal weight of the distance to the goal", least=0)
    w_v: float = quantity(10.0, "s^2/m^2", "terminal weight of the velocity", least=0)
    u_max: float = quantity(15.0, "N", "largest push", above=0)


def build(params: Params) -> Problem:
    """Return the problem of the box in Zhang et al. (2023), fig. 6b: steps (box-slide.1), friction (box-slide.2).

    The floor's normal force is m g. The smoothed step from rest is ``v+ = -(2 mu/h) f/(b² - f²)``.
    A push below friction m g does not move a box at rest, so the exact law's gradient is zero there.
    """
    p = table(params)
    system = time_stepping(
        name,
        states=signals("x [m]; v [m/s]"),
        inputs=signals("u [N] push"),
        contacts=signals("floor [N s] friction impulse"),
        h=p["h"],
        mass=p["m"] * ca.SX.eye(1),
        impulse=lambda q, v, u: p["h"] * u,
        sliding=lambda q: ca.SX.ones(1),
        load=p["m"] * p["g"],
        friction=p["friction"],
        parameters=p,
    )
    x, u = system.x, system.u
    return pose_problem(
        params,
        system,
        stage_cost=p["w_u"] * p["h"] * u**2,
        terminal_cost=p["w_end"] * (x[0] - p["goal"]) ** 2 + p["w_v"] * x[1] ** 2,
        x0=ca.vertcat(p["x0"], p["v0"]),
        scaling=Scaling(impulse=0.05, gap=0.25, x=1.0, u=5.0),
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw floor, goal and box; the box has a size only in the picture."""
    side = 0.2
    return [Wall(0, 0, 0, 1), Mark(params.goal, side / 2, "goal"), Rectangle(float(state[0]), side / 2, side, side)]


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frame of the floor on the box, with Coulomb's coefficient."""
    return [ContactFrame(float(state[0]), 0, 0, 1, params.friction)]
