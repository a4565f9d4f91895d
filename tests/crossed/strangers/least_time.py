"""The shortest time to a place before a wall, at rest."""

from dynamics.systems import signals, time_stepping
from ocp import Constraint, free
from ocp.problem.problem import Problem
from problems.parameters import Parameters, quantity, structure, table

name, title = "shuttle", "A shuttle in the least time"


class Params(Parameters):
    m: float = quantity(1.5, "kg", "shuttle", above=0)
    F: float = quantity(5.0, "N", "largest force", above=0)
    way: float = quantity(0.6, "m", "way", above=0)
    h: float = quantity(0.1, "s", "step at the start of the search", above=0)
    N: int = structure(6, "steps", least=2)


def build(params):
    p = table(params)
    system = time_stepping(
        name,
        states=signals("x [m]; v [m/s]"),
        inputs=signals("F [N]"),
        contacts=signals("wall [N s]"),
        h=p["h"],
        mass=p["m"],
        impulse=lambda q, v, u: p["h"] * u,
        distance=lambda q: 1.1 * p["way"] - q,
        parameters=p,
    )
    x, v = system.x[0], system.x[1]
    ends = [Constraint("there", x - p["way"], 0, 0), Constraint("rest", v, 0, 0)]
    return Problem(
        name,
        system,
        params.N,
        stage_cost=0,
        terminal_cost=params.N * p["h"],
        x0=[0, 0],
        parameters=p,
        u_lower=-p["F"],
        u_upper=p["F"],
        terminal=ends,
        h=free(0.01, 0.5),
    )
