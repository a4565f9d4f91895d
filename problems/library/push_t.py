"""A T-shaped body on a table, pushed on one of its eight sides at a time to a goal pose."""

from __future__ import annotations

from typing import TypeVar

import casadi as ca
import numpy as np

from ocp.problem.problem import Problem, Scaling
from problems.drawing import ContactFrame, Shape
from problems.parameters import Parameters, pose_problem, quantity, structure, table
from problems.sides import SidePushing, outline, side_frames
from problems.spec import Citation, Golden

name = "push-t"
title = "Pushing a T to a pose, with a free contact point"
citation = Citation("li2025crisp", "CRISP, push T; see also CRISP's code, src/examples/pushT")
equations = r"""
0 <= w_i perp w_i - F_i + sum_(j != i) F_j >= 0, quad abs(m) <= 1 / 2 sum_i w_i L_i
(x', y') = R(theta) sum_i w_i n_i \/ (mu_f m_b g), quad
  theta' = (m + sum_i w_i (c_i times n_i)) \/ (mu_f m_b g c r), quad r = 2.8 b
e = norm((x, y) - (x, y)_"goal")^2 + (cos theta - cos theta_"goal")^2
  + (sin theta - sin theta_"goal")^2
min sum_(k=0)^(N-1) w_x e_k + w_F norm(F_k)^2 + w_"end" e_N
"""
golden = {
    "exact": Golden(
        0.8619986665,
        settings={"strategy": "l1"},
        start=5,
        tried=40,
        note="with FMA the same solve ends in the neighbouring local minimum 0.8620344554",
        # The relative difference of minima whose contact schedules differ by one step is 1e-5 to 1e-4;
        # on processors with FMA the last bit of a sine selects one of two minima that differ by 4.2e-5.
        tolerance=5e-5,
    )
}

_CENTRE = 2.6429
"""Height of the centre of mass above the foot of the stem, in widths of the stem."""
Width = TypeVar("Width", ca.SX, float)


class Params(Parameters):
    """Parameters of ``push-t`` with the source's values; the bar is 4 widths long, and the stem 3 widths."""

    width: float = quantity(0.05, "m", "width of bar and stem", above=0)
    m: float = quantity(1.0, "kg", "mass of the T", above=0)
    friction: float = quantity(0.4, "1", "Coulomb's coefficient with the table", above=0)
    g: float = quantity(9.8, "m/s^2", "gravity", above=0)
    c: float = quantity(0.4, "1", "largest moment of friction, over that of its force at r", above=0)
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(50, "number of steps", least=1)
    x0: float = quantity(0.24722, "m", "start, x")
    y0: float = quantity(0.0141359, "m", "start, y")
    angle0: float = quantity(-2.95844, "rad", "start, angle")
    goal_x: float = quantity(0.036, "m", "goal, x")
    goal_y: float = quantity(-0.143, "m", "goal, y")
    goal_angle: float = quantity(-2.637, "rad", "goal, angle")
    w_x: float = quantity(1.0, "1", "stage weight of the distance to the goal", least=0)
    w_F: float = quantity(0.01, "1/N^2", "weight of the forces", least=0)
    w_end: float = quantity(100.0, "1", "terminal weight of the distance to the goal", least=0)


def _corners(width: Width) -> list[tuple[Width, Width]]:
    """Return the corners of the T relative to its centre of mass, counter-clockwise from the foot of the stem."""
    corners = (-0.5, 0), (0.5, 0), (0.5, 3), (2, 3), (2, 4), (-2, 4), (-2, 3), (-0.5, 3)
    return [(x * width, (y - _CENTRE) * width) for x, y in corners]


def build(params: Params) -> Problem:
    """Return the problem with steps (push-t.1), (push-t.2) and the error (push-t.3) in cosine and sine of the angle."""
    p = table(params)
    pushed = SidePushing(name, _corners(p["width"]), p["c"] * 2.8 * p["width"], p)
    system = pushed.system
    x, angle, sides = system.x, p["goal_angle"], system.nlam
    away = ca.vertcat(
        x[0] - p["goal_x"], x[1] - p["goal_y"], ca.cos(x[2]) - ca.cos(angle), ca.sin(x[2]) - ca.sin(angle)
    )
    return pose_problem(
        params,
        system,
        stage_cost=p["w_x"] * ca.sumsqr(away) + p["w_F"] * ca.sumsqr(system.u[:sides]),
        terminal_cost=p["w_end"] * ca.sumsqr(away),
        x0=ca.vertcat(p["x0"], p["y0"], p["angle0"]),
        u_lower=pushed.u_lower,
        path=[pushed.on_the_side],
        scaling=Scaling(impulse=2.0, gap=2.0, x=1.0, u=2.0),
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw the T and its goal."""
    goal = np.array([params.goal_x, params.goal_y, params.goal_angle])
    corners = _corners(params.width)
    return [*outline(corners, goal, "goal"), *outline(corners, state, "object")]


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frame of every side."""
    return side_frames(_corners(params.width), state)
