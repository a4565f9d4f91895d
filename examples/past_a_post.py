"""A pusher brings an object past a post: contacts and drawing are made from the shapes."""

import casadi as ca

from ocp import Problem, Scaling, solve
from problems.parameters import Parameters, quantity, structure, table
from problems.scenes import Body, Disc, Goal, Obstacle, Pusher, Scene, drawing_functions

name = "past-a-post"
title = "An object pushed past a post"


class Params(Parameters):
    """All numbers: value, unit, meaning, range. Set one with -p NAME=VALUE."""

    R: float = quantity(0.2, "m", "radius of the object", above=0)
    r: float = quantity(0.1, "m", "radius of the pusher", above=0)
    post: float = quantity(0.1, "m", "radius of the post", above=0)
    friction: float = quantity(0.3, "1", "Coulomb's coefficient, pusher on object", least=0)
    goal_x: float = quantity(1.0, "m", "goal of the object, x")
    goal_y: float = quantity(0.3, "m", "goal of the object, y")
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(40, "number of steps", least=1)  # shapes the problem, is no symbol


def scene(p):
    """What there is; any two things of which one moves may touch."""
    return Scene(
        [
            Pusher("pusher", Disc(p["r"]), at=(-0.4, 0.0), stiffness=50.0),
            Body("object", Disc(p["R"]), at=(0.0, 0.0), mass=1.0, inertia=0.02),
            Obstacle("post", Disc(p["post"]), at=(0.5, 0.1)),
            Goal("object", at=(p["goal_x"], p["goal_y"])),
        ],
        friction={("pusher", "object"): p["friction"]},  # other pairs are smooth
    )


draw, frames = drawing_functions(scene)


def build(params: Params) -> Problem:
    """The input is the commanded place of the pusher [m]; effort is how fast it changes."""
    p = table(params)  # a symbol for each quantity
    things = scene(p)
    system = things.quasi_dynamic(name, p, h=p["h"])  # things.time_stepping has velocities
    off = things.coordinates_of("object", system.x)[:2] - ca.vertcat(p["goal_x"], p["goal_y"])
    du = ca.SX.sym("du", system.nu)  # change of the input
    return Problem(
        name,
        system,
        params.N,
        stage_cost=0.01 * ca.sumsqr(off) + 0.1 * ca.sumsqr(du),
        terminal_cost=10 * ca.sumsqr(off),
        x0=things.at_rest(system),
        parameters=p,
        du=du,
        u_before=things.hold,  # input before the first step
        scaling=Scaling(impulse=0.5, gap=0.1, x=0.5, u=0.5),  # usual sizes
    )


if __name__ == "__main__":
    print(solve(__file__, contact="exact").verdict)
