"""A bar lifts itself off a rough floor on one arm: a machine from a table of links."""

import casadi as ca
import numpy as np

from dynamics.systems import Link, Machine, Sphere
from ocp import Problem, Scaling
from problems.drawing import ContactFrame, Shape
from problems.machines.machine import machine_frames, machine_shapes
from problems.parameters import Parameters, quantity, structure, table

name = "push-up"
title = "A push-up on one arm"
axes = ("x [m]", "z [m]")
# A tree of links in the vertical plane; angles [rad] count clockwise, lengths are in metres.
machine = Machine(
    links=(
        Link("body", None, mass=1.0, inertia=0.03, joint="free"),  # or hinge, or slide
        Link(
            "arm",
            "body",
            mass=0.3,
            inertia=0.004,  # [kg], [kg m^2] about the centre of mass
            com=(0.2, 0),
            anchor=(0.3, 0),  # centre of mass; joint in the frame of the body
            gear=5.0,
            damping=0.1,
            limits=(-1.0, 2.0),  # motor [N m] at u = 1; joint [N m s], [rad]
        ),
    ),
    # What may touch the ground z = 0: name, link, centre in its frame, radius.
    spheres=(
        Sphere("tail", "body", (-0.3, 0), 0.05),
        Sphere("nose", "body", (0.3, 0), 0.05),
        Sphere("hand", "arm", (0.4, 0), 0.05),
    ),
)


class Params(Parameters):
    """All numbers: value, unit, meaning, range. Set one with -p NAME=VALUE."""

    friction: float = quantity(0.7, "1", "Coulomb's coefficient with the floor", above=0)
    lift: float = quantity(0.5, "rad", "how far to lift the bar")
    h: float = quantity(0.05, "s", "step size", above=0)
    N: int = structure(40, "number of steps", least=1)  # shapes the problem, is no symbol


def build(params: Params) -> Problem:
    """The state is x, z and angle of the body, angle of the arm; then their velocities."""
    p = table(params)  # a symbol for each quantity
    system = machine.system(name, p, h=p["h"], friction=p["friction"])
    x, v = system.x[:4], system.x[4:]
    return Problem(
        name,
        system,
        params.N,
        stage_cost=0.05 * (system.u**2 + 0.01 * ca.sumsqr(v)),
        terminal_cost=100 * (x[2] + p["lift"]) ** 2 + ca.sumsqr(v),
        parameters=p,
        x0=ca.vertcat(0, 0.05, ca.SX.zeros(6)),
        u_lower=-1,
        u_upper=1,  # torque limits, in units of gear
        scaling=Scaling(impulse=0.5, gap=0.1),  # usual size of a contact impulse and of a gap
    )


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """The machine at one state, for pages and animations."""
    return machine_shapes(machine, state)


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Place and normal of every contact, for the arrows of its force."""
    return machine_frames(machine, state, None, params.friction)
