"""A mass comes in too fast for its brake, and rests at the goal because it may use the wall."""

import casadi as ca

from dynamics.systems import signals, time_stepping
from ocp.problem import Problem, Scaling
from problems.parameters import Parameters, quantity, table

name, title = "bumper", "A mass that brakes against a wall"


class Params(Parameters):
    """The wall is at x = 0, in the way of the mass."""

    m: float = quantity(1.0, "kg", "mass", above=0)
    h: float = quantity(0.1, "s", "step size", above=0)
    v0: float = quantity(-3.0, "m/s", "speed at the start")
    goal: float = quantity(0.2, "m", "where to rest", above=0)


def build(params: Params) -> Problem:
    """u and lam are impulses [N s]; effort and distance are weighed against each other."""
    p = table(params)
    system = time_stepping(
        name, states=signals("x [m] position; v [m/s] velocity"),
        inputs=signals("u [N s] impulse"), contacts=signals("wall [N s] impulse of the wall"),
        h=p["h"], mass=p["m"], impulse=lambda q, v, u: u, distance=lambda q: q, parameters=p,
    )  # fmt: skip
    x, v = system.x[0], system.x[1]
    return Problem(
        name, system, N=20, stage_cost=0.1 * system.u**2, parameters=p,
        terminal_cost=10 * (x - p["goal"]) ** 2 + 10 * v**2, x0=ca.vertcat(1.0, p["v0"]),
        u_lower=-0.1, u_upper=0.1, scaling=Scaling(impulse=1.0, gap=0.1),
    )  # fmt: skip
