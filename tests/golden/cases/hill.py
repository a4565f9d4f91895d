"""A mass on a hill next to a wall: unstable, linear without contact, and quick to solve."""

import casadi as ca

from dynamics.systems import signals, time_stepping
from ocp import Problem, Scaling, Scenarios
from problems.parameters import Parameters, quantity, structure, table

name = "hill"
title = "A mass on a hill beside a wall"
equations = """
v^+ = v + h (a x + u \\/ m) + lambda \\/ m, quad x^+ = x + h v^+, quad 0 <= lambda perp x^+ + 1 >= 0
"""


class Params(Parameters):
    """Without a force x grows by exp(16) over the default horizon."""

    m: float = quantity(1.0, "kg", "mass", above=0)
    a: float = quantity(16.0, "1/s^2", "slope of the hill", least=0)
    u_max: float = quantity(20.0, "N", "largest force", above=0)
    start: float = quantity(0.5, "m", "position at the start")
    w_u: float = quantity(1e-2, "m^2/N^2", "weight of the force", least=0)
    w_end: float = quantity(10.0, "s", "weight of the last position", least=0)
    w_rest: float = quantity(1.0, "s^3", "weight of the last velocity", least=0)
    h: float = quantity(0.1, "s", "step size", above=0)
    N: int = structure(40, "number of steps", least=1)
    scenarios: int = structure(1, "starts, a nanometre apart", least=1)


def build(params: Params) -> Problem:
    """Build the problem with semi-implicit steps and a cost that is an integral over time."""
    p = table(params)
    system = time_stepping(
        name,
        states=signals("x [m] position; v [m/s] velocity"),
        inputs=signals("u [N] force"),
        contacts=signals("wall [N s] impulse of the wall"),
        h=p["h"],
        mass=p["m"],
        impulse=lambda q, v, u: p["h"] * (p["m"] * p["a"] * q + u),
        distance=lambda q: q + 1,
        parameters=p,
    )
    x, v = system.x[0], system.x[1]
    return Problem(
        name,
        system,
        params.N,
        stage_cost=p["h"] * (x**2 + p["w_u"] * system.u**2),
        parameters=p,
        terminal_cost=p["w_end"] * x**2 + p["w_rest"] * v**2,
        x0=ca.vertcat(p["start"], 0),
        u_lower=-p["u_max"],
        u_upper=p["u_max"],
        scenarios=Scenarios(params.scenarios, (1e-9, 1e-9)),
        scaling=Scaling(impulse=1.0, gap=0.1, x=1.0, u=1.0),
    )
