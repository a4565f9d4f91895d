"""An elbow that must not turn beyond its stop, over a table that its hand may touch."""

import casadi as ca

from dynamics.systems import Link, Machine, Sphere
from ocp.problem.problem import Problem
from problems.parameters import Parameters, quantity, structure, table

name, title = "elbow", "An arm whose elbow has a stop"
machine = Machine(
    links=(
        Link("upper", None, mass=0.7, inertia=0.01, com=(0, -0.15), anchor=(0, 0.5), gear=4.0),
        Link(
            "fore",
            "upper",
            mass=0.4,
            inertia=5e-3,
            com=(0, -0.1),
            anchor=(0, -0.3),
            gear=2.0,
            limits=(-0.4, 1.2),
        ),
    ),
    spheres=(Sphere("hand", "fore", (0, -0.2), 0.03),),
)


class Params(Parameters):
    friction: float = quantity(0.5, "1", "hand on table", least=0)
    h: float = quantity(0.03, "s", "step", above=0)
    N: int = structure(6, "steps", least=1)


def build(params):
    p = table(params)
    system = machine.system(name, p, h=p["h"], friction=p["friction"])
    off = system.x[:2] - ca.vertcat(0.4, -0.6)
    return Problem(
        name,
        system,
        params.N,
        stage_cost=0.01 * ca.sumsqr(system.u),
        parameters=p,
        terminal_cost=10 * ca.sumsqr(off),
        x0=[0.5, 0, 0, 0],
        u_lower=-1,
        u_upper=1,
    )
