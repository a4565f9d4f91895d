"""Friction is mu in every textbook, and sigma the width of my box."""

import casadi as ca

from dynamics.systems import signals, time_stepping
from ocp.problem.problem import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table

name, title = "mu", "A box on the floor"


class Params(Parameters):
    mu: float = quantity(0.3, "1", "friction", least=0)
    h: float = quantity(0.05, "s", "step", above=0)
    sigma: float = quantity(0.1, "m", "width of the box", above=0)
    kappa: float = quantity(2.0, "kg", "mass", above=0)
    penalty: float = quantity(10.0, "1/m^2", "weight of the end", least=0)
    N: int = structure(8, "steps", least=1)


def build(params):
    p = table(params)
    system = time_stepping(
        name,
        states=signals("x [m]; z [m]; vx [m/s]; vz [m/s]"),
        inputs=signals("u [N]"),
        contacts=signals("floor [N s]"),
        h=p["h"],
        mass=p["kappa"] * ca.SX.eye(2),
        impulse=lambda q, v, u: p["h"] * ca.vertcat(u, -9.81 * p["kappa"]),
        distance=lambda q: q[1] - p["sigma"] / 2,
        sliding=lambda q: ca.SX([[1.0, 0.0]]),
        friction=p["mu"],
        parameters=p,
    )
    x = system.x
    return Problem(
        name,
        system,
        params.N,
        stage_cost=1e-3 * system.u**2,
        parameters=p,
        terminal_cost=p["penalty"] * (x[0] - 0.2) ** 2 + ca.sumsqr(x[2:]),
        x0=ca.vertcat(0, p["sigma"] / 2, 0, 0),
        u_lower=-20,
        u_upper=20,
        scaling=Scaling(gap=0.05),
    )
