"""A mass comes in too fast for its brake, and rests at the goal because it may use the wall."""

import casadi as ca
import numpy as np

from dynamics.systems import signals, time_stepping
from ocp import Problem, Scaling
from problems.drawing import Circle, Mark, Shape, Wall
from problems.parameters import Parameters, quantity, structure, table

name = "bumper"
title = "A mass that brakes against a wall"
# Typst's mathematics, an equation a line, for ocp show and reports; you may leave it out.
equations = """
m (v^+ - v) = u + lambda, quad x^+ = x + h v^+, quad 0 <= lambda perp x^+ >= 0
min sum_(k=0)^(N-1) w u_k^2 + 10 (x_N - x_"goal")^2 + 10 v_N^2, quad abs(u) <= u_"max"
"""


class Params(Parameters):
    """All numbers: value, unit, meaning, range. Set one with -p NAME=VALUE."""

    m: float = quantity(1.0, "kg", "mass", above=0)
    v0: float = quantity(-3.0, "m/s", "speed at the start")
    goal: float = quantity(0.2, "m", "where to rest", above=0)
    u_max: float = quantity(0.1, "N s", "largest impulse of the brake in a step", above=0)
    w: float = quantity(0.1, "1/(N s)^2", "weight of the input", least=0)
    h: float = quantity(0.1, "s", "step size", above=0)
    N: int = structure(20, "number of steps", least=1)  # shapes the problem, is no symbol


def build(params: Params) -> Problem:
    """u and lam are impulses over one step [N s]."""
    p = table(params)  # a symbol for each quantity
    system = time_stepping(
        name,
        states=signals("x [m] position; v [m/s] velocity"),  # positions q, then velocities v
        inputs=signals("u [N s] impulse of the brake"),
        contacts=signals("wall [N s] impulse of the wall"),
        h=p["h"],
        mass=p["m"],
        impulse=lambda q, v, u: u,  # all impulses but those of contacts: h times the forces
        distance=lambda q: q,  # signed distance [m] of each contact; add sliding and friction
        parameters=p,
    )
    x, v = system.x[0], system.x[1]
    return Problem(
        name,
        system,
        params.N,
        stage_cost=p["w"] * system.u**2,
        parameters=p,
        terminal_cost=10 * (x - p["goal"]) ** 2 + 10 * v**2,
        x0=ca.vertcat(1.0, p["v0"]),
        u_lower=-p["u_max"],
        u_upper=p["u_max"],
        scaling=Scaling(impulse=1.0, gap=0.1),  # usual size of a contact impulse and of a gap
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """The wall, the goal and the mass at one state, for pages and animations."""
    mass = Circle(float(state[0]) + 0.1, 0, 0.1)
    return [Wall(0, 0, 1, 0), Mark(params.goal + 0.1, 0, "goal"), mass]
