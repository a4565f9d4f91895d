"""A box on a table that is pushed on one side at a time to a goal position and heading."""

from __future__ import annotations

import math
from typing import Any

import casadi as ca
import numpy as np

from ocp.problem.problem import Problem, Scaling
from problems.drawing import ContactFrame, Shape
from problems.parameters import Parameters, pose_problem, quantity, structure, table
from problems.sides import SidePushing, outline, side_frames
from problems.spec import Citation, Golden

name = "push-box"
title = "Pushing a box to a heading, with a free contact point"
citation = Citation("li2025crisp", "CRISP, push box; see also CRISP's code, src/examples/pushbox")
equations = r"""
0 <= w_i perp w_i - F_i + sum_(j != i) F_j >= 0, quad abs(m) <= 1 / 2 sum_i w_i L_i
(x', y') = R(theta) sum_i w_i n_i \/ (mu_f m_b g), quad
  theta' = (m + sum_i w_i (c_i times n_i)) \/ (mu_f m_b g c r), quad r = sqrt(a^2 + b^2)
min w_"end" norm((x, y, theta)_N - (d cos phi, d sin phi, phi))^2 + w_F sum_(k=0)^(N-1) norm(F_k)^2
"""
golden = {"exact": Golden(5.5740820650, settings={"strategy": "scholtes-exact"}, tried=40)}


class Params(Parameters):
    """Parameters of ``push-box`` with the source's values, whose goal headings are k pi/9 for k = 0 to 17."""

    a: float = quantity(0.5, "m", "half the length of the box", above=0)
    b: float = quantity(0.25, "m", "half the width of the box", above=0)
    m: float = quantity(1.0, "kg", "mass of the box", above=0)
    friction: float = quantity(0.5, "1", "Coulomb's coefficient with the table", above=0)
    g: float = quantity(9.8, "m/s^2", "gravity", above=0)
    c: float = quantity(0.4, "1", "largest moment of friction, over that of its force at r", above=0)
    h: float = quantity(0.02, "s", "step size", above=0)
    N: int = structure(100, "number of steps", least=1)
    distance: float = quantity(3.0, "m", "distance of the goal", least=0)
    heading: float = quantity(2 * math.pi / 9, "rad", "direction of the goal, and the box's angle there")
    w_end: float = quantity(100.0, "1", "terminal weight of the distance to the goal", least=0)
    w_F: float = quantity(1e-3, "1/N^2", "weight of the forces", least=0)


def build(params: Params) -> Problem:
    """Return the problem with steps (push-box.1), (push-box.2) and cost (push-box.3).

    At the optimum the cost of F equals the cost of w, since a force without effect only adds cost.
    """
    p = table(params)
    a, b = p["a"], p["b"]
    pushed = SidePushing(name, _corners(a, b), p["c"] * ca.sqrt(a**2 + b**2), p)
    system, phi = pushed.system, p["heading"]
    goal = ca.vertcat(p["distance"] * ca.cos(phi), p["distance"] * ca.sin(phi), phi)
    return pose_problem(
        params,
        system,
        stage_cost=p["w_F"] * ca.sumsqr(system.u[:4]),
        terminal_cost=p["w_end"] * ca.sumsqr(system.x - goal),
        x0=ca.SX.zeros(3),
        u_lower=pushed.u_lower,
        path=[pushed.on_the_side],
        scaling=Scaling(impulse=5.0, gap=5.0, x=1.0, u=5.0),
    )


def _corners(a: Any, b: Any) -> list[tuple[Any, Any]]:
    return [(-a, -b), (a, -b), (a, b), (-a, b)]


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw box and goal."""
    d, phi = params.distance, params.heading
    goal = np.array([d * math.cos(phi), d * math.sin(phi), phi])
    corners = _corners(params.a, params.b)
    return [*outline(corners, goal, "goal"), *outline(corners, state, "object")]


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frame of every side."""
    return side_frames(_corners(params.a, params.b), state)
