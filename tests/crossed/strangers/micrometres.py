"""A microgripper's jaw closes to its stop; everything is micrometres, milligrams and seconds."""

import casadi as ca

from dynamics.systems import signals, time_stepping
from ocp.problem.problem import Problem
from problems.parameters import Parameters, quantity, structure, table

name, title = "jaw", "The jaw of a microgripper"


class Params(Parameters):
    m: float = quantity(2.0, "mg", "jaw", above=0)
    stop: float = quantity(35.0, "um", "way to the stop", above=0)
    goal: float = quantity(30.0, "um", "where to rest")
    h: float = quantity(1e-3, "s", "step", above=0)
    N: int = structure(8, "steps", least=1)


def build(params):
    p = table(params)
    system = time_stepping(
        name,
        states=signals("x [um]; v [um/s]"),
        inputs=signals("F [mg um/s^2]"),
        contacts=signals("stop [mg um/s]"),
        h=p["h"],
        mass=p["m"],
        impulse=lambda q, v, u: p["h"] * u,
        distance=lambda q: p["stop"] - q,
        parameters=p,
    )
    x, v = system.x[0], system.x[1]
    return Problem(
        name,
        system,
        params.N,
        stage_cost=1e-14 * system.u**2,
        parameters=p,
        terminal_cost=(x - p["goal"]) ** 2 + 1e-6 * v**2,
        x0=ca.vertcat(0, 9e3),
        u_lower=-5e6,
        u_upper=5e6,
    )
