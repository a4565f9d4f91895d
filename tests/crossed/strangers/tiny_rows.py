"""A flow that must stay below 2e-9 m^3/s while a valve's plate closes on its seat."""

from dynamics.systems import signals, time_stepping
from ocp.problem.problem import Constraint, Problem
from problems.parameters import Parameters, quantity, structure, table

name, title = "valve", "The plate of a valve"


class Params(Parameters):
    m: float = quantity(0.01, "kg", "plate", above=0)
    area: float = quantity(1e-8, "m^2", "area of the pipe", above=0)
    h: float = quantity(0.01, "s", "step", above=0)
    N: int = structure(8, "steps", least=1)


def build(params):
    p = table(params)
    system = time_stepping(
        name,
        states=signals("x [m]; v [m/s]"),
        inputs=signals("F [N]"),
        contacts=signals("seat [N s]"),
        h=p["h"],
        mass=p["m"],
        impulse=lambda q, v, u: p["h"] * u,
        distance=lambda q: q,
        parameters=p,
    )
    x, v = system.x[0], system.x[1]
    return Problem(
        name,
        system,
        params.N,
        stage_cost=0.01 * system.u**2,
        parameters=p,
        terminal_cost=1e4 * x**2,
        x0=[0.02, 0],
        u_lower=-1,
        u_upper=1,
        path=[Constraint("flow", p["area"] * v, -2e-9, 2e-9)],
    )
