"""The cost has the price of the machine in it."""

import casadi as ca

from dynamics.systems import signals, time_stepping
from ocp.problem.problem import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table

name, title = "buffer", "A wagon brakes at a buffer"


class Params(Parameters):
    m: float = quantity(3.0, "kg", "wagon", above=0)
    v0: float = quantity(-2.0, "m/s", "speed")
    price: float = quantity(1e6, "1", "constant of the cost")
    h: float = quantity(0.1, "s", "step", above=0)
    N: int = structure(8, "steps", least=1)


def build(params):
    p = table(params)
    system = time_stepping(
        name,
        states=signals("x [m]; v [m/s]"),
        inputs=signals("J [N s]"),
        contacts=signals("buffer [N s]"),
        h=p["h"],
        mass=p["m"],
        impulse=lambda q, v, u: u,
        distance=lambda q: q,
        parameters=p,
    )
    x, v = system.x[0], system.x[1]
    return Problem(
        name,
        system,
        params.N,
        stage_cost=0.2 * system.u**2,
        parameters=p,
        terminal_cost=4 * (x - 0.3) ** 2 + 4 * v**2 + p["price"],
        x0=ca.vertcat(0.9, p["v0"]),
        u_lower=-0.2,
        u_upper=0.2,
        scaling=Scaling(impulse=3.0, gap=0.1),
    )
