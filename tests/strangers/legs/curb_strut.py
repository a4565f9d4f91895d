"""A round trunk climbs a curb by pushing itself off the ground with a strut.

It resembles wheel-leg climbing: a smooth disc of 3 kg has a strut that its hip motor turns and a second motor
lengthens. The curb is 0.08 m high, the trunk's radius 0.12 m, so that the strut must push up and forward from behind,
by friction of its foot. Staying in front costs 20 x 0.16. The best-known value is plausible since the climb's energy
is fixed and the foot has one good position, as far under the trunk as the hip allows.
"""

import casadi as ca
import numpy as np

from dynamics.systems import WORLD, Link, Machine, Part, Sphere
from dynamics.systems.shapes import Box
from ocp import Problem, Scaling
from problems.machines.machine import machine_shapes
from problems.parameters import Parameters, quantity, structure, table

name = "curb-strut"
title = "A trunk climbs a curb with its strut"
axes = ("x [m]", "z [m]")
machine = Machine(
    links=(
        Link("cart", None, mass=0.1, inertia=1.0, joint="slide", axis=(1.0, 0.0)),
        Link("trunk", "cart", mass=2.9, inertia=1.0, joint="slide", axis=(0.0, 1.0)),
        Link("hip", "trunk", mass=0.3, inertia=0.01, com=(0.0, -0.05), gear=15.0, limits=(-0.2, 1.4)),
        Link("strut", "hip", mass=0.2, inertia=0.002, joint="slide", axis=(0.0, -1.0), gear=60.0, limits=(0.0, 0.25)),
    ),
    spheres=(Sphere("belly", "trunk", (0.0, 0.0), 0.12), Sphere("foot", "strut", (0.0, -0.1), 0.015)),
    parts=(Part("curb", WORLD, Box((0.3, 0.04), centre=(0.5, 0.04))),),
    collision_pairs=(("belly", "curb"),),
)


class Params(Parameters):
    """The trunk starts at x = 0 and must come to rest at x = 0.4 on the curb, which begins at x = 0.2."""

    friction: float = quantity(0.7, "1", "Coulomb's coefficient of the foot", above=0)
    goal: float = quantity(0.4, "m", "where to rest on the curb")
    h: float = quantity(0.03, "s", "step size", above=0)
    N: int = structure(45, "number of steps", least=1)


def build(params: Params) -> Problem:
    """Build the problem; states are the trunk's x and z, the hip's angle, the strut's extension, and velocities."""
    p = table(params)
    system = machine.system(name, p, h=p["h"], friction=ca.vertcat(0.05, p["friction"], 0.05))
    x = system.x
    off = x[:2] - ca.vertcat(p["goal"], 0.2)
    return Problem(
        name,
        system,
        params.N,
        stage_cost=0.01 * ca.sumsqr(system.u),
        terminal_cost=20 * ca.sumsqr(off) + 0.2 * ca.sumsqr(x[4:]),
        x0=ca.vertcat(0, 0.12, 0.6, 0.0, 0, 0, 0, 0),
        parameters=p,
        u_lower=-1,
        u_upper=1,
        scaling=Scaling(impulse=0.5, gap=0.1, x=0.3, u=0.5),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the trunk is up on the curb."""
    return bool(state[0] > 0.3 and state[1] > 0.15)


def draw(params: Params, state: np.ndarray):
    """Return the shapes of the machine at one state."""
    return machine_shapes(machine, state)
