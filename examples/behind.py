"""The pusher stands on the wrong side: it must walk round its object, and round a post."""

import casadi as ca

from ocp import Constraint, Problem, Scaling, solve
from problems.parameters import Parameters, quantity, structure, table
from problems.scenes import Body, Disc, Goal, Obstacle, Pusher, Scene, drawing_functions

name = "behind"
title = "An object that must come back past a post"


class Params(Parameters):
    """The pusher begins between the object and its goal; the post narrows one way round."""

    R: float = quantity(0.2, "m", "radius of the object", above=0)
    r: float = quantity(0.1, "m", "radius of the pusher", above=0)
    friction: float = quantity(0.3, "1", "Coulomb's coefficient, pusher on object", least=0)
    goal_x: float = quantity(-0.5, "m", "goal of the object, x")
    post_x: float = quantity(0.0, "m", "place of the post, x")
    post_y: float = quantity(-0.35, "m", "place of the post, y")
    post_r: float = quantity(0.1, "m", "radius of the post", above=0)
    reach: float = quantity(0.08, "m", "largest stretch of the motor's spring", above=0)
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(70, "number of steps", least=1)


def scene(p):
    """What stands on the table; the post is smooth."""
    return Scene(
        [
            Pusher("pusher", Disc(p["r"]), at=(-0.4, -0.1), stiffness=50.0),
            Body("object", Disc(p["R"]), at=(0.0, 0.0), mass=1.0, inertia=0.02),
            Obstacle("post", Disc(p["post_r"]), at=(p["post_x"], p["post_y"])),
            Goal("object", at=(p["goal_x"], 0.0)),
        ],
        friction={("pusher", "object"): p["friction"]},
    )


draw, frames = drawing_functions(scene)


def build(params: Params) -> Problem:
    """Effort is how fast the commanded place of the pusher changes."""
    p = table(params)
    things = scene(p)
    system = things.quasi_dynamic(name, p, h=p["h"])
    off = things.coordinates_of("object", system.x)[:2] - ca.vertcat(p["goal_x"], 0)
    stretch = system.u - things.coordinates_of("pusher", system.x)
    du = ca.SX.sym("du", system.nu)
    return Problem(
        name,
        system,
        params.N,
        stage_cost=0.01 * ca.sumsqr(off) + 0.1 * ca.sumsqr(du),
        terminal_cost=10 * ca.sumsqr(off),
        x0=things.at_rest(system),
        parameters=p,
        du=du,
        u_before=things.hold,
        path=[Constraint("reach", stretch, -p["reach"], p["reach"])],
        scaling=Scaling(impulse=0.5, gap=0.1, x=0.5, u=0.5),
    )


if __name__ == "__main__":
    print(solve(__file__, contact="exact").verdict)
