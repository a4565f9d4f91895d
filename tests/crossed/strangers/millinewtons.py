"""My motor takes millinewtons, the rest is SI."""

import casadi as ca

from dynamics.systems import signals, time_stepping
from ocp.problem.problem import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table

name, title = "slider", "A slider between two stops"


class Params(Parameters):
    m: float = quantity(0.15, "kg", "slider", above=0)
    goal: float = quantity(0.08, "m", "goal")
    F: float = quantity(900.0, "mN", "largest force", above=0)
    h: float = quantity(0.02, "s", "step", above=0)
    N: int = structure(8, "steps", least=1)


def build(params):
    p = table(params)
    system = time_stepping(
        name,
        states=signals("x [m]; v [m/s]"),
        inputs=signals("F [mN]"),
        contacts=signals("left [N s]; right [N s]"),
        h=p["h"],
        mass=p["m"],
        impulse=lambda q, v, u: p["h"] * u / 1000,
        distance=lambda q: ca.vertcat(q + 0.1, 0.1 - q),
        parameters=p,
    )
    x, v = system.x[0], system.x[1]
    return Problem(
        name,
        system,
        params.N,
        stage_cost=1e-6 * system.u**2,
        parameters=p,
        terminal_cost=100 * (x - p["goal"]) ** 2 + v**2,
        x0=[0, 0],
        u_lower=-p["F"],
        u_upper=p["F"],
        scaling=Scaling(impulse=0.02),
    )
