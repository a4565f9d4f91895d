"""A cart pushes a block up a rough slope and leaves it there at rest."""

import casadi as ca

from ocp import Problem, Scaling, solve
from problems.parameters import Parameters, quantity, structure, table
from problems.scenes import Body, Box, Disc, Goal, HalfPlane, Obstacle, Pusher, Scene, drawing_functions

name = "slope"
title = "A cart pushes a block up a rough slope"
axes = ("x [m]", "height [m]")


class Params(Parameters):
    """On a slope of less than atan(friction) the block stays where it is left."""

    angle: float = quantity(0.3, "rad", "angle of the slope", least=0, most=1.2)
    friction: float = quantity(0.5, "1", "Coulomb's coefficient, block on slope", least=0)
    m: float = quantity(1.0, "kg", "mass of the block", above=0)
    cart: float = quantity(2.0, "kg", "mass of the cart", above=0)
    half: float = quantity(0.15, "m", "half side of the block along the slope", above=0)
    high: float = quantity(0.1, "m", "half side of the block across it", above=0)
    way: float = quantity(0.8, "m", "how far up the block shall go")
    g: float = quantity(9.81, "m/s^2", "gravity", above=0)
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(40, "number of steps", least=1)


def on_slope(p, along, above):
    """The place at a way up the slope and a height above it."""
    c, s = ca.cos(p["angle"]), ca.sin(p["angle"])
    return (along * c - above * s, along * s + above * c)


def scene(p):
    """Cart and block are smooth to each other; the cart runs on rails beside the slope."""
    r = 0.1
    block = Box((p["half"], p["high"]))
    return Scene(
        [
            Pusher("cart", Disc(r), at=on_slope(p, -0.4, r), mass=p["cart"], axis=on_slope(p, 1, 0)),
            Body(
                "block",
                block,
                at=on_slope(p, 0, p["high"]),
                angle=p["angle"],
                mass=p["m"],
                inertia=p["m"] * (p["half"] ** 2 + p["high"] ** 2) / 3,
            ),
            Obstacle("slope", HalfPlane(normal=on_slope(p, 0, 1)), at=(0.0, 0.0)),
            Goal("block", at=on_slope(p, p["way"], p["high"]), angle=p["angle"]),
        ],
        friction={("block", "slope"): p["friction"]},
        non_colliding=[("cart", "slope")],
    )


draw, frames = drawing_functions(scene)


def build(params: Params) -> Problem:
    """u is the cart's force along the slope [N]; the block shall come to rest at its goal."""
    p = table(params)
    things = scene(p)
    system = things.time_stepping(name, p, h=p["h"], gravity=(0, -p["g"]))
    x = system.x
    nq = system.nx // 2
    off = things.coordinates_of("block", x)[:2] - ca.vertcat(*on_slope(p, p["way"], p["high"]))
    return Problem(
        name,
        system,
        params.N,
        stage_cost=p["h"] * 0.01 * ca.sumsqr(system.u),
        terminal_cost=1000 * ca.sumsqr(off) + 10 * ca.sumsqr(x[nq:]),
        x0=things.at_rest(system),
        parameters=p,
        u_lower=-40,
        u_upper=40,
        # The block is 0.2 m high: with a characteristic gap of half of that the first, wide stage
        # lets it fly, and tumble.
        scaling=Scaling(impulse=0.5, gap=0.02, x=0.5, u=5.0),
    )


if __name__ == "__main__":
    print(solve(__file__, contact="exact").verdict)
