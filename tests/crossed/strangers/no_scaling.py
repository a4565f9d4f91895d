"""A paddle under a ball: I do not know what a scaling is."""

import casadi as ca

from dynamics.systems import signals, time_stepping
from ocp.problem.problem import Problem
from problems.parameters import Parameters, quantity, structure, table

name, title = "paddle", "A paddle lifts a ball"


class Params(Parameters):
    m: float = quantity(0.06, "kg", "ball", above=0)
    M: float = quantity(0.4, "kg", "paddle", above=0)
    top: float = quantity(0.5, "m", "where the ball goes")
    h: float = quantity(0.02, "s", "step", above=0)
    N: int = structure(8, "steps", least=1)


def build(params):
    p = table(params)
    system = time_stepping(
        name,
        states=signals("ball [m]; paddle [m]; vb [m/s]; vp [m/s]"),
        inputs=signals("F [N]"),
        contacts=signals("hit [N s]"),
        h=p["h"],
        mass=ca.diag(ca.vertcat(p["m"], p["M"])),
        impulse=lambda q, v, u: p["h"] * ca.vertcat(-9.81 * p["m"], u - 9.81 * p["M"]),
        distance=lambda q: q[0] - q[1],
        parameters=p,
    )
    x = system.x
    return Problem(
        name,
        system,
        params.N,
        stage_cost=1e-3 * system.u**2 + 0.1 * x[1] ** 2,
        terminal_cost=5 * (x[0] - p["top"]) ** 2,
        x0=[0.02, 0, 0, 0],
        parameters=p,
    )
