"""A pusher moves one puck, which has to move the other."""

import casadi as ca

from ocp.problem.problem import Problem
from problems.parameters import Parameters, quantity, structure, table
from problems.scenes import Body, Disc, Goal, Pusher, Scene, drawing_functions

name, title = "two-pucks", "One puck pushes another"


class Params(Parameters):
    friction: float = quantity(0.2, "1", "everywhere", least=0)
    goal: float = quantity(0.5, "m", "goal of the second puck")
    h: float = quantity(0.1, "s", "step", above=0)
    N: int = structure(5, "steps", least=1)


def scene(p):
    return Scene(
        [
            Pusher("finger", Disc(0.04), at=(-0.2, 0.0), stiffness=80.0),
            Body("near", Disc(0.1), at=(0.0, 0.0), mass=0.5, inertia=2e-3),
            Body("far", Disc(0.08), at=(0.25, 0.02), mass=0.4, inertia=1e-3),
            Goal("far", at=(p["goal"], 0.0)),
        ],
        friction=p["friction"],
    )


draw, frames = drawing_functions(scene)


def build(params):
    p = table(params)
    things = scene(p)
    system = things.quasi_dynamic(name, p, h=p["h"])
    off = things.coordinates_of("far", system.x)[:2] - ca.vertcat(p["goal"], 0)
    du = ca.SX.sym("du", system.nu)
    return Problem(
        name,
        system,
        params.N,
        stage_cost=0.1 * ca.sumsqr(du),
        parameters=p,
        du=du,
        terminal_cost=10 * ca.sumsqr(off),
        x0=things.at_rest(system),
        u_before=things.hold,
    )
