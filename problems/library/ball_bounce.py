"""A ball with thrusters above a floor, with plastic impacts."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.systems import signals, time_stepping
from ocp.problem.problem import Problem, Scaling
from problems.drawing import Circle, ContactFrame, Mark, Shape, Wall
from problems.parameters import Parameters, pose_problem, quantity, structure, table
from problems.spec import Citation, Golden, smoothed

name = "ball-bounce"
title = "A ball with thrust over a floor"
citation = Citation("zhang2023adaptive", "Adaptive barrier smoothing, fig. 1a, with thrust")
equations = """
m (v^+ - v) = h (u - (0, m g)) + (0, lambda), quad q^+ = q + h v^+, quad 0 <= lambda perp y^+ >= 0
min sum_(k=0)^(N-1) w_u h norm(u_k)^2 + w_"end" norm(q_N - q_"goal")^2 + w_v norm(v_N)^2
norm(u)_infinity <= u_"max", quad "from" (x_0, y_0, v_(x,0), v_(y,0))
"""
golden = {
    "exact": Golden(
        0.745009295,
        tried=33,
        independent="all 820 windows of contact, each a convex QP",
        note="other minima: 0.760166, 0.849701",
    ),
    "barrier mu=1e-3": smoothed(0.703942109, tried=11),
}


class Params(Parameters):
    """Parameters of ``ball-bounce``; the floor is at y = 0."""

    m: float = quantity(1.0, "kg", "mass", above=0)
    g: float = quantity(9.81, "m/s^2", "gravity")
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(40, "number of steps", least=1)
    x0: float = quantity(0.0, "m", "start, x")
    y0: float = quantity(1.0, "m", "start, height", least=0)
    vx0: float = quantity(1.0, "m/s", "start velocity, x")
    vy0: float = quantity(-6.0, "m/s", "start velocity, y")
    goal_x: float = quantity(2.0, "m", "goal, x")
    goal_y: float = quantity(0.5, "m", "goal, height")
    w_u: float = quantity(0.01, "1/(N^2 s)", "stage weight of the thrust", least=0)
    w_end: float = quantity(100.0, "1/m^2", "terminal weight of the distance to the goal", least=0)
    w_v: float = quantity(1.0, "s^2/m^2", "terminal weight of the velocity", least=0)
    u_max: float = quantity(15.0, "N", "largest thrust", above=0)


def build(params: Params) -> Problem:
    """Return the problem of a point with plastic time steps (ball-bounce.1); u is a force [N], lam an impulse [N s]."""
    p = table(params)
    weight = ca.vertcat(0, p["m"] * p["g"])
    system = time_stepping(
        name,
        states=signals("x [m]; y [m] height; vx [m/s]; vy [m/s]"),
        inputs=signals("ux [N] thrust; uy [N] thrust"),
        contacts=signals("floor [N s] impulse of the floor"),
        h=p["h"],
        mass=p["m"] * ca.SX.eye(2),
        impulse=lambda q, v, u: p["h"] * (u - weight),
        distance=lambda q: q[1],
        parameters=p,
    )
    x, u = system.x, system.u
    squared_distance = ca.sumsqr(x[:2] - ca.vertcat(p["goal_x"], p["goal_y"]))
    return pose_problem(
        params,
        system,
        stage_cost=p["w_u"] * p["h"] * ca.sumsqr(u),
        terminal_cost=p["w_end"] * squared_distance + p["w_v"] * ca.sumsqr(x[2:]),
        x0=ca.vertcat(p["x0"], p["y0"], p["vx0"], p["vy0"]),
        scaling=Scaling(impulse=1.0, gap=0.1, x=1.0, u=5.0),
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw floor, goal and ball; the ball is a point in the model and has a radius only in the picture."""
    radius = 0.05
    return [
        Wall(0, 0, 0, 1),
        Mark(params.goal_x, params.goal_y + radius, "goal"),
        Circle(float(state[0]), float(state[1]) + radius, radius),
    ]


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frame of the floor, whose normal points upwards."""
    return [ContactFrame(float(state[0]), float(state[1]), 0, 1)]
