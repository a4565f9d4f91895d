"""Take one step with a biped of five links and point feet.

It resembles RABBIT: torso, two thighs, two shanks, motors at hips and knees, no ankles. It stands with one foot in
front of the other and must stand 0.3 m further on with the feet exchanged. Standing still costs at least 20 x 0.09,
and falling more. The best-known value is probably only an upper bound: a biped has many open-loop plans, and the best
of several routes is kept.
"""

import casadi as ca
import numpy as np

from dynamics.systems import Link, Machine, Sphere
from ocp import Problem, Scaling
from problems.machines.machine import machine_shapes
from problems.parameters import Parameters, quantity, structure, table

name = "biped-step"
title = "A five-link biped takes a step"
axes = ("x [m]", "z [m]")
THIGH, SHANK = 0.4, 0.4  # lengths [m]


def leg(side: str) -> tuple[Link, Link]:
    """Return thigh and shank of a leg at the torso's lower end."""
    thigh = Link(f"{side} thigh", "torso", mass=3.0, inertia=0.05, com=(0, -0.15), gear=80.0, damping=0.5)
    shank = Link(
        f"{side} shank",
        f"{side} thigh",
        mass=1.5,
        inertia=0.02,
        com=(0, -0.2),
        anchor=(0, -THIGH),
        gear=80.0,
        damping=0.5,
        limits=(0.0, 2.0),
    )
    return thigh, shank


torso = Link("torso", None, mass=10.0, inertia=0.6, com=(0, 0.25), joint="free")
machine = Machine(
    links=(torso, *leg("left"), *leg("right")),
    spheres=tuple(Sphere(f"{side} foot", f"{side} shank", (0, -SHANK), 0.02) for side in ("left", "right")),
)


class Params(Parameters):
    """Parameters are of the stride and the floor."""

    stride: float = quantity(0.3, "m", "how far the hip goes")
    friction: float = quantity(0.8, "1", "Coulomb's coefficient of the feet", above=0)
    h: float = quantity(0.025, "s", "step size", above=0)
    N: int = structure(28, "number of steps", least=1)


def build(params: Params) -> Problem:
    """Build the problem; states are the torso's x, z and angle, hips and knees, clockwise, and velocities."""
    p = table(params)
    system = machine.system(name, p, h=p["h"], friction=p["friction"])
    q, v = system.x[:7], system.x[7:]
    front, back = (-0.45, 0.4), (0.05, 0.4)  # thigh and knee of a leg
    height = THIGH * np.cos(0.45) + SHANK * np.cos(0.05) + 0.02
    start = ca.DM([0, height, 0, *front, *back])
    goal = ca.vertcat(p["stride"], height, 0, *back, *front)
    return Problem(
        name,
        system,
        params.N,
        stage_cost=0.01 * ca.sumsqr(system.u),
        terminal_cost=20 * ca.sumsqr((q - goal) * ca.DM([1, 1, 0.5, 0.5, 0.5, 0.5, 0.5])) + 0.05 * ca.sumsqr(v),
        x0=ca.vertcat(start, ca.DM.zeros(7)),
        parameters=p,
        u_lower=-1,
        u_upper=1,
        scaling=Scaling(impulse=4, gap=0.1, x=0.3, u=0.3),
    )


def reached(params: Params, state: np.ndarray) -> bool:
    """Return whether the biped is upright, one stride ahead."""
    return bool(abs(state[0] - params.stride) < 0.1 and state[1] > 0.65 and abs(state[2]) < 0.4)


def draw(params: Params, state: np.ndarray):
    """Return the shapes of the biped at one state."""
    return machine_shapes(machine, state)
