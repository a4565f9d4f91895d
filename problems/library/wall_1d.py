"""A mass that is pushed against a wall: the smallest problem with contact."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.systems import signals, time_stepping
from ocp.problem.problem import Problem, Scaling
from problems.drawing import ContactFrame, Mark, Rectangle, Shape, Wall
from problems.parameters import Parameters, pose_problem, quantity, structure, table
from problems.spec import Citation, Golden, smoothed

name = "wall-1d"
title = "A mass against a wall"
citation = Citation("suh2022pathologies", "Pathologies of differentiable simulators, ex. IV.1-2")
axes = ("x [m]", "")
equations = """
m (v^+ - v) = u + lambda, quad x^+ = x + h v^+, quad 0 <= lambda perp x^+ >= 0
min sum_(k=0)^(N-1) w_x (x_k - x_"goal")^2 + w_v v_k^2 + w_u u_k^2 + w_"end" (x_N - x_"goal")^2
abs(u) <= u_"max", quad "from" (x_0, v_0)
"""
golden = {
    "exact": Golden(
        17.8301723,
        tried=33,
        independent="all 465 windows of contact, each a convex QP",
        note="another minimum: 17.83099",
    ),
    "barrier mu=1e-3": smoothed(17.9404268, tried=11, note="other minima: 17.94222"),
}


class Params(Parameters):
    """Parameters of ``wall-1d``; the wall is at x = 0, the goal behind it."""

    m: float = quantity(1.0, "kg", "mass", above=0)
    h: float = quantity(0.1, "s", "step size", above=0)
    N: int = structure(30, "number of steps", least=1)
    x0: float = quantity(1.0, "m", "start position", least=0)
    v0: float = quantity(0.0, "m/s", "start velocity")
    goal_x: float = quantity(-0.5, "m", "goal position")
    w_x: float = quantity(1.0, "1/m^2", "stage weight of the distance to the goal", least=0)
    w_v: float = quantity(0.1, "s^2/m^2", "stage weight of the velocity", least=0)
    w_u: float = quantity(0.01, "1/(N s)^2", "stage weight of the input", least=0)
    w_end: float = quantity(10.0, "1/m^2", "terminal weight of the distance to the goal", least=0)
    u_max: float = quantity(1.0, "N s", "largest input impulse", above=0)


def build(params: Params) -> Problem:
    """Return the problem with steps (wall-1d.1) of Suh et al. (2022), ex. IV.1-2; u and lam are impulses [N s]."""
    p = table(params)
    system = time_stepping(
        name,
        states=signals("x [m] position; v [m/s] velocity"),
        inputs=signals("u [N s] impulse"),
        contacts=signals("wall [N s] impulse of the wall"),
        h=p["h"],
        mass=p["m"],
        impulse=lambda q, v, u: u,
        distance=lambda q: q,
        parameters=p,
    )
    x, v, u = system.x[0], system.x[1], system.u
    error = x - p["goal_x"]
    return pose_problem(
        params,
        system,
        stage_cost=p["w_x"] * error**2 + p["w_v"] * v**2 + p["w_u"] * u**2,
        terminal_cost=p["w_end"] * error**2,
        x0=ca.vertcat(p["x0"], p["v0"]),
        scaling=Scaling(impulse=1.0, gap=0.1, x=1.0, u=0.5),
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw the wall, the goal behind it, and the mass in front of it."""
    return [Wall(0, 0, 1, 0), Mark(params.goal_x, 0, "goal"), Rectangle(float(state[0]) + 0.05, 0, 0.1, 0.1)]


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frame of the wall, whose normal points to positive x."""
    return [ContactFrame(float(state[0]), 0, 1, 0)]
