"""How do I swing up a pendulum on a cart? Nothing touches anything."""

import casadi as ca

from dynamics.systems import Link, Machine
from ocp.problem.problem import Problem
from problems.parameters import Parameters, quantity, structure, table

name, title = "swing-up", "A pendulum on a cart swings up"
machine = Machine(
    links=(
        Link("cart", None, mass=0.8, inertia=1.0, joint="slide", axis=(1, 0), gear=15.0),
        Link("pole", "cart", mass=0.25, inertia=2e-4, com=(0, -0.4)),
    ),
    spheres=(),
)


class Params(Parameters):
    h: float = quantity(0.04, "s", "step", above=0)
    N: int = structure(8, "steps", least=1)


def build(params):
    p = table(params)
    system = machine.system(name, p, h=p["h"], friction=None)
    off = system.x - ca.vertcat(0, 3.14159, 0, 0)
    return Problem(
        name,
        system,
        params.N,
        stage_cost=p["h"] * (ca.sumsqr(off) + system.u**2),
        terminal_cost=10 * ca.sumsqr(off),
        x0=[0, 0, 0, 0],
        parameters=p,
        u_lower=-1,
        u_upper=1,
    )
