"""Two discs that change places; one is driven and pushes the other."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.systems import signals, time_stepping
from ocp.problem.problem import Problem, Scaling
from problems.drawing import Circle, Mark, Shape
from problems.parameters import Parameters, pose_problem, quantity, structure, table
from problems.spec import Citation

name = "discs-swap"
title = "Two discs that change places, one of them driven (nosnoc)"
citation = Citation("nurkanovic2022nosnoc", "nosnoc's code, examples, disc_switch_position")
equations = r"""
m_i (v_i^+ - v_i) = h (delta_(i 1) u - d v_i / norm(v_i + 0.1)) + (-1)^i n lambda, quad q^+ = q + h v^+, quad
  n = (q_2 - q_1) / norm(q_2 - q_1)
0 <= lambda perp norm(q_2^+ - q_1^+) - r_1 - r_2 >= 0
min h sum_(k=0)^(N-1) (e_k + w_u norm(u_k)^2) + w_"end" e_N, quad
  e = w_1 norm(q_1 - q_1^"goal")^2 + w_2 norm(q_2 - q_2^"goal")^2
norm(u)_infinity <= u_"max", quad norm(v)_infinity <= 5, quad norm(q)_infinity <= 10
"""
SMALL_SPEED = 0.1
"""Speed [m/s] added to every component in the denominator of the drag."""


class Params(Parameters):
    """Parameters of ``discs-swap``, with the source's values."""

    m1: float = quantity(2.0, "kg", "mass of the driven disc", above=0)
    m2: float = quantity(1.0, "kg", "mass of the other disc", above=0)
    r1: float = quantity(0.3, "m", "radius of the driven disc", above=0)
    r2: float = quantity(0.2, "m", "radius of the other disc", above=0)
    drag: float = quantity(2.0, "N", "drag of a disc at high speed", least=0)
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(60, "number of steps", least=1)
    x1: float = quantity(-1.0, "m", "start of the driven disc, x")
    y1: float = quantity(0.0, "m", "start of the driven disc, y")
    x2: float = quantity(1.0, "m", "start of the other disc, x")
    y2: float = quantity(0.0, "m", "start of the other disc, y")
    gx1: float = quantity(1.0, "m", "goal of the driven disc, x")
    gy1: float = quantity(0.0, "m", "goal of the driven disc, y")
    gx2: float = quantity(-1.0, "m", "goal of the other disc, x")
    gy2: float = quantity(0.0, "m", "goal of the other disc, y")
    w_1: float = quantity(5.0, "1/(m^2 s)", "weight of the driven disc's distance", least=0)
    w_2: float = quantity(10.0, "1/(m^2 s)", "weight of the other disc's distance", least=0)
    w_u: float = quantity(0.1, "1/(N^2 s)", "weight of the force", least=0)
    w_end: float = quantity(100.0, "s", "factor of the distances at the end", least=0)
    u_max: float = quantity(20.0, "N", "largest force in either direction", above=0)


def build(params: Params) -> Problem:
    """Return the problem with steps (discs-swap.1), plastic contact (discs-swap.2) and cost (discs-swap.3)."""
    return pose_discs(name, params)


def pose_discs(problem_name: str, params: Params) -> Problem:
    """Return the problem of two discs under a name; the source collocates with switches between the nodes."""
    p = table(params)
    h, masses = p["h"], ca.vertcat(p["m1"], p["m1"], p["m2"], p["m2"])

    def impulse(q: ca.SX, v: ca.SX, u: ca.SX) -> ca.SX:
        drag = [p["drag"] * speed / ca.norm_2(speed + SMALL_SPEED) for speed in (v[:2], v[2:])]
        return h * (ca.vertcat(u, 0, 0) - ca.vertcat(*drag))

    system = time_stepping(
        problem_name,
        states=signals(
            "x1 [m] driven; y1 [m] driven; x2 [m] other; y2 [m] other; vx1 [m/s]; vy1 [m/s]; vx2 [m/s]; vy2 [m/s]"
        ),
        inputs=signals("ux [N] force; uy [N] force"),
        contacts=signals("push [N s] impulse between the discs"),
        h=h,
        mass=ca.diag(masses),
        impulse=impulse,
        distance=lambda q: ca.norm_2(q[2:] - q[:2]) - p["r1"] - p["r2"],
        parameters=p,
    )
    x, u = system.x, system.u
    goal = ca.vertcat(p["gx1"], p["gy1"], p["gx2"], p["gy2"])
    weights = ca.vertcat(p["w_1"], p["w_1"], p["w_2"], p["w_2"])
    distance = ca.dot(weights, (x[:4] - goal) ** 2)
    largest = ca.SX([10.0] * 4 + [5.0] * 4)
    return pose_problem(
        params,
        system,
        stage_cost=h * (distance + p["w_u"] * ca.sumsqr(u)),
        terminal_cost=p["w_end"] * distance,
        x0=ca.vertcat(p["x1"], p["y1"], p["x2"], p["y2"], ca.SX.zeros(4)),
        x_lower=-largest,
        x_upper=largest,
        scaling=Scaling(impulse=1.0, gap=0.2, x=1.0, u=5.0),
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw both discs and their goals."""
    x1, y1, x2, y2 = (float(value) for value in state[:4])
    goals: list[Shape] = [Mark(params.gx1, params.gy1, "goal"), Mark(params.gx2, params.gy2, "goal")]
    return [*goals, Circle(x1, y1, params.r1, "actuator"), Circle(x2, y2, params.r2)]
