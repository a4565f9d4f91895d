"""A finger of two links, and a disc on a pin that it turns."""

from __future__ import annotations

import math

import numpy as np

from dynamics.systems import ContactSystem, Link, Machine, ParameterTable, Part, shapes
from problems.drawing import Circle, ContactFrame, Segment, Shape, Stadium
from problems.machines.tracking import in_torques
from problems.parameters import Parameters, friction_of, quantity

STEPS = r"""
M(q) (v^+ - v) = h (u - b(q, v) - D v^+) + J_n^top gamma + J_t^top (beta^+ - beta^-), quad
  q^+ = q + h v^+, quad q "= (shoulder, elbow, disc), clockwise"
0 <= gamma perp phi(q^+) >= 0, quad phi = norm(p(q) - c) - R - r, quad
  0 <= beta^plus.minus perp psi plus.minus h J_t v^+ >= 0, quad
  0 <= psi perp f gamma - beta^+ - beta^- >= 0
"""
"""Equations of the finger and the disc, in the mathematical notation of typst."""
LINK_RADIUS = 0.03
"""Radius of the links in the picture [m]."""


class FingerParams(Parameters):
    """Parameters of a finger at the origin and a disc on its pin."""

    length: float = quantity(1.0, "m", "length of either link", above=0)
    m: float = quantity(1.0, "kg", "mass of either link, centred in its middle", above=0)
    inertia: float = quantity(0.0839, "kg m^2", "inertia of either link about its centre", above=0)
    damping: float = quantity(0.1, "N m s/rad", "damping of either joint", least=0)
    g: float = quantity(9.81, "m/s^2", "gravity")
    r: float = quantity(0.05, "m", "radius of the fingertip, which ends with the link", least=0)
    R: float = quantity(0.25, "m", "radius of the disc", above=0)
    x: float = quantity(1.5, "m", "position of the disc's pin, forward")
    z: float = quantity(1.0, "m", "position of the disc's pin, upward")
    disc_inertia: float = quantity(0.074, "kg m^2", "inertia of the disc", above=0)
    disc_damping: float = quantity(0.1, "N m s/rad", "damping of the disc", least=0)
    friction: float = quantity(0.5, "1", "Coulomb's coefficient of tip and disc", least=0)
    h: float = quantity(0.05, "s", "step size", above=0)


def finger_system(name: str, p: ParameterTable) -> ContactSystem:
    """Return the contact system of shoulder, elbow and disc, with torques [N m] at the finger's joints.

    The state is (q, v), with angles clockwise from straight up. The centre of the fingertip is at
    the distance ``r`` from the end of the second link; no other part of the finger has contacts. The disc is balanced
    on its pin.
    """
    p, friction = friction_of(p)
    length, r = p["length"], p["r"]
    link = {"mass": p["m"], "inertia": p["inertia"], "com": (0.0, length / 2), "gear": 1.0, "damping": p["damping"]}
    machine = Machine(
        (
            Link("shoulder", None, **link),
            Link("elbow", "shoulder", anchor=(0.0, length), **link),
            # The disc is balanced on its pin, so that its mass has no effect.
            Link("disc", None, 1.0, p["disc_inertia"], anchor=(p["x"], p["z"]), damping=p["disc_damping"]),
        ),
        (),
        parts=(Part("tip", "elbow", shapes.Disc(r, (0.0, length - r))), Part("disc", "disc", shapes.Disc(p["R"]))),
        collision_pairs=(("tip", "disc"),),
        gravity=p["g"],
    )
    return in_torques(machine.system(name, p, h=p["h"], friction=friction))


def finger_shapes(params: FingerParams, state: np.ndarray, goal: float) -> list[Shape]:
    """Draw links, tip, and the disc, with one radius at its angle and another at the angle ``goal`` [rad]."""
    (x, z), elbow, tip = (params.x, params.z), *_elbow_and_tip(params, state)
    disc = Circle(x, z, params.R)

    def spoke(angle: float, role: str) -> Segment:
        return Segment(x, z, x + params.R * math.sin(angle), z + params.R * math.cos(angle), role)

    return [
        disc,
        spoke(goal, "goal"),
        spoke(float(state[2]), "object"),
        Stadium(0.0, 0.0, *elbow, LINK_RADIUS, "actuator"),
        Stadium(*elbow, *tip, LINK_RADIUS, "actuator"),
        Circle(*tip, params.r, "actuator"),
    ]


def finger_frames(params: FingerParams, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frame at the tip's point nearest to the disc, with the normal into the disc."""
    tip = np.array(_elbow_and_tip(params, state)[1])
    to_disc = np.array([params.x, params.z]) - tip
    nx, nz = (float(v) for v in to_disc / np.linalg.norm(to_disc))
    x, z = float(tip[0]) + params.r * nx, float(tip[1]) + params.r * nz
    return [ContactFrame(x, z, nx, nz, params.friction)]


def _elbow_and_tip(params: FingerParams, state: np.ndarray) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the positions of the elbow and of the centre of the fingertip [m]."""
    upper, fore = float(state[0]), float(state[0] + state[1])
    a, b = params.length, params.length - params.r
    elbow = a * math.sin(upper), a * math.cos(upper)
    return elbow, (elbow[0] + b * math.sin(fore), elbow[1] + b * math.cos(fore))
