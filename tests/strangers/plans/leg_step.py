"""Jump onto a step with one leg of two links.

It resembles the planar hopper on a boom: the trunk slides up, down and forward without rotation, hip and knee have
motors, and the foot is a ball. The step is 0.15 m high and begins 0.2 m ahead. Crouching in front of it costs
20 x 0.19. The best-known value is plausible since the horizon is long enough for one jump only, and plans differ only
in how deep the leg crouches first.
"""

import casadi as ca
import numpy as np

from dynamics.systems import WORLD, Link, Machine, Part, Sphere
from dynamics.systems.shapes import Box
from ocp import Problem, Scaling
from problems.machines.machine import machine_shapes
from problems.parameters import Parameters, quantity, structure, table

name = "leg-step"
title = "A leg jumps onto a step"
axes = ("x [m]", "z [m]")
BEND = 0.7  # angle of the hip, and half that of the knee, at the start and at the end [rad]
machine = Machine(
    links=(
        Link("boom", None, mass=0.2, inertia=1.0, joint="slide", axis=(1.0, 0.0)),
        Link("trunk", "boom", mass=2.0, inertia=1.0, joint="slide", axis=(0.0, 1.0)),
        Link("thigh", "trunk", mass=0.4, inertia=0.003, com=(0.0, -0.12), gear=30.0, damping=0.1, limits=(-1.6, 1.6)),
        Link(
            "shank",
            "thigh",
            mass=0.2,
            inertia=0.002,
            com=(0.0, -0.1),
            anchor=(0.0, -0.25),
            gear=30.0,
            damping=0.1,
            limits=(0.1, 2.4),
        ),
    ),
    spheres=(Sphere("foot", "shank", (0.0, -0.25), 0.02),),
    parts=(Part("step", WORLD, Box((0.3, 0.075), centre=(0.5, 0.075))),),
    collision_pairs=(("foot", "step"),),
)


class Params(Parameters):
    """The trunk must come to rest over the centre of the step."""

    friction: float = quantity(0.8, "1", "Coulomb's coefficient of the foot", above=0)
    goal: float = quantity(0.4, "m", "where to stand on the step")
    h: float = quantity(0.025, "s", "step size", above=0)
    N: int = structure(36, "number of steps", least=1)


def build(params: Params) -> Problem:
    """Build the problem; the state is the trunk's x and z, hip and knee, clockwise, and their velocities."""
    p = table(params)
    system = machine.system(name, p, h=p["h"], friction=p["friction"])
    x, v = system.x[:4], system.x[4:]
    height = 0.5 * np.cos(BEND) + 0.02
    off = ca.vertcat(x[0] - p["goal"], x[1] - height - 0.15, 0.2 * (x[2] + BEND), 0.2 * (x[3] - 2 * BEND))
    return Problem(
        name,
        system,
        params.N,
        stage_cost=0.005 * ca.sumsqr(system.u),
        terminal_cost=20 * ca.sumsqr(off) + 0.05 * ca.sumsqr(v),
        x0=ca.DM([0, height, -BEND, 2 * BEND, 0, 0, 0, 0]),
        parameters=p,
        u_lower=-1,
        u_upper=1,
        scaling=Scaling(impulse=0.7, gap=0.1, x=0.3, u=0.5),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the trunk is above the step, higher than it could stand in front of it."""
    return bool(abs(state[0] - params.goal) < 0.15 and state[1] > 0.45)


def draw(params: Params, state: np.ndarray):
    """Return the shapes of the leg at one state."""
    return machine_shapes(machine, state)
