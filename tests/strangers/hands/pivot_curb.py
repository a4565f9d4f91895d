"""Stand a crate on end against a wall, about its lower corner, which a cleat on the floor holds.

It resembles pivoting by extrinsic dexterity: one fingertip at the far end lifts it by friction, and turns the crate
about the corner that the cleat holds, until its upper side is at the wall. The finger starts away from the end face,
and must touch it before anything turns. Lying costs 10 (pi/2)^2, which is 24.7. The best-known value is plausible
since the crate's weight bounds the work of the finger from below, and searches from many starts stay above it.
"""

import casadi as ca
import numpy as np

from dynamics.systems import Link, Machine, Part
from dynamics.systems.shapes import Box, Disc
from ocp import Problem, Scaling
from problems.parameters import Parameters, quantity, structure, table

name = "pivot-curb"
title = "A crate pivoted about its corner against a wall"
axes = ("x [m]", "z [m]")


class Params(Parameters):
    """The crate is 0.4 m long and 0.12 m high; the wall is 0.12 m to the right of the cleat."""

    mass: float = quantity(0.6, "kg", "mass of the crate", above=0)
    friction: float = quantity(0.5, "1", "Coulomb's coefficient of the finger on the crate", least=0)
    force: float = quantity(12.0, "N", "largest force of the finger", above=0)
    h: float = quantity(0.04, "s", "step size", above=0)
    N: int = structure(35, "number of steps", least=1)


def build(params: Params) -> Problem:
    """Build the problem; the state is the crate's clockwise angle, the finger's position, and their velocities."""
    p = table(params)
    inertia = p["mass"] * (0.4**2 + 0.12**2) / 12
    crate = Link("crate", None, mass=p["mass"], inertia=inertia, com=(-0.2, 0.06), limits=(0.0, np.pi / 2))
    rail = Link("rail", None, mass=0.1, inertia=1.0, joint="slide", axis=(1.0, 0.0), gear=1.0)
    finger = Link("finger", "rail", mass=0.1, inertia=1.0, joint="slide", axis=(0.0, 1.0), gear=1.0)
    machine = Machine(
        links=(crate, rail, finger),
        spheres=(),
        parts=(
            Part("box", "crate", Box((0.2, 0.06), centre=(-0.2, 0.06))),
            Part("tip", "finger", Disc(0.02)),
        ),
        collision_pairs=(("tip", "box"),),
    )
    system = machine.system(name, p, h=p["h"], friction=p["friction"])
    x, u = system.x, system.u
    return Problem(
        name,
        system,
        params.N,
        stage_cost=1e-3 * ((u[0]) ** 2 + (u[1] - 0.981) ** 2),
        terminal_cost=10 * (x[0] - np.pi / 2) ** 2 + 0.1 * ca.sumsqr(x[3:]),
        x0=ca.vertcat(0, -0.47, 0.05, 0, 0, 0),
        parameters=p,
        u_lower=-p["force"],
        u_upper=p["force"],
        scaling=Scaling(impulse=0.2, gap=0.1, x=0.3, u=4),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the crate is upright."""
    return state[0] > 1.4
