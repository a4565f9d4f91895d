"""A small quadruped in space, with 12 motors and 12.5 kg, that trots, stands up from the floor, or jumps."""

from __future__ import annotations

from functools import cache
from math import cos
from typing import Any

import numpy as np

from dynamics.systems.space import Body, Box, Capsule, Plane, SpatialMachine, SpatialPart, Sphere
from ocp.problem.problem import Problem, Scaling
from problems.drawing import ContactFrame, Shape
from problems.machines.gait import STEPS, GaitParams, gait
from problems.machines.perspective import PinholeCamera
from problems.machines.spatial import AXES, spatial_frames, spatial_shapes
from problems.parameters import choice
from problems.spec import Citation, Golden

name = "quadruped"
title = "Quadruped: trot, stand up or jump"
citation = Citation("stewart1996implicit", "the time stepping; the machine is our own")
axes = AXES
equations = STEPS
golden = {
    "exact": Golden(
        0.112610318055, settings={"strategy": "scholtes"}, tried=3, note="other minima: 0.1217705, 0.1250533"
    )
}
TRUNK = (0.19, 0.05, 0.05)
"""Half the length, width and height of the trunk [m]."""
TRUNK_MASS = 6.9
"""Mass of the trunk [kg]."""
LINK = 0.2
"""Length of a thigh and of a shin [m]."""
FOOT = 0.02
"""Radius of a foot [m]."""
HIP_X = 0.18
"""Distance of the hips from the trunk's middle along x [m]."""
HIP_Y = 0.047
"""Distance of the hips from the trunk's middle along y [m]."""
HIP_WIDTH = 0.08
"""Lateral distance of the leg from the axis of its hip joint [m]."""
LEGS = {"fl": (1, 1), "fr": (1, -1), "hl": (-1, 1), "hr": (-1, -1)}
"""Mapping from a leg (fore or hind, left or right) to the signs of its position along x and y."""
MOTOR: dict[str, Any] = {"damping": 0.05, "armature": 0.005, "gear": 25.0}
"""Damping [N m s/rad], armature [kg m^2] and torque of one unit of input [N m] of every joint."""


def _rod_inertia(mass: float) -> tuple[float, float, float]:
    """Return the inertias about x, y, z [kg m^2] of a link, a vertical rod with a radius of 2 cm."""
    long, thick = mass * LINK**2 / 12, mass * 0.02**2 / 2
    return long, long, thick


def _leg_bodies(leg: str, fore: int, left: int) -> list[Body]:
    """Return hip (0.7 kg), thigh (0.6 kg) and shin (0.1 kg) of a leg; ``fore`` and ``left`` are 1 or -1."""
    hip = Body(
        f"{leg}_hip",
        "trunk",
        0.7,
        (7e-4, 9e-4, 7e-4),
        com=(0.0, 0.02 * left, 0.0),
        position=(HIP_X * fore, HIP_Y * left, 0.0),
        axis=(1.0, 0.0, 0.0),
        limits=(-0.8, 0.8),
        **MOTOR,
    )
    shoulder, knee = (0.0, HIP_WIDTH * left, 0.0), (0.0, 0.0, -LINK)
    thigh = Body(
        f"{leg}_thigh", hip.name, 0.6, _rod_inertia(0.6), (0.0, 0.0, -0.05), shoulder, limits=(-1.0, 3.0), **MOTOR
    )
    shin = Body(
        f"{leg}_shin", thigh.name, 0.1, _rod_inertia(0.1), (0.0, 0.0, -LINK / 2), knee, limits=(-2.7, -0.4), **MOTOR
    )
    return [hip, thigh, shin]


def _leg_parts(leg: str, left: int) -> list[SpatialPart]:
    origin, down = (0.0, 0.0, 0.0), (0.0, 0.0, -LINK)
    return [
        SpatialPart(f"{leg} hip", f"{leg}_hip", Capsule(origin, (0.0, HIP_WIDTH * left, 0.0), 0.035)),
        SpatialPart(f"{leg} thigh", f"{leg}_thigh", Capsule(origin, down, 0.02)),
        SpatialPart(f"{leg} shin", f"{leg}_shin", Capsule(origin, down, 0.012)),
        SpatialPart(leg, f"{leg}_shin", Sphere(FOOT, down)),
    ]


@cache
def quadruped(belly: bool = False) -> SpatialMachine:
    """Return the machine: a trunk on four legs of three joints; one unit of input is 25 N m.

    At q = 0 the legs hang straight down; hips turn about x, thighs and shins about y. Feet are spheres
    with a radius of 2 cm; with ``belly`` the lower corners of the trunk can also touch the ground.
    """
    a, b, c = (2 * half for half in TRUNK)
    inertia = tuple(TRUNK_MASS * (s * s + t * t) / 12 for s, t in ((b, c), (a, c), (a, b)))
    bodies = [Body("trunk", None, TRUNK_MASS, inertia, joint="free")]
    parts = [SpatialPart("floor", "world", Plane()), SpatialPart("trunk", "trunk", Box(TRUNK))]
    touching = []
    for leg, (fore, left) in LEGS.items():
        bodies += _leg_bodies(leg, fore, left)
        parts += _leg_parts(leg, left)
        touching.append(leg)
        if belly:
            corner = (fore * TRUNK[0], left * TRUNK[1], -TRUNK[2])
            parts.append(SpatialPart(f"{leg} belly", "trunk", Sphere(0.0, corner)))
            touching.append(f"{leg} belly")
    return SpatialMachine(tuple(bodies), tuple(parts), tuple((part, "floor") for part in touching))


def pose(x: float, z: float, thigh: float, shin: float) -> np.ndarray:
    """Return q (19,) with the trunk level at (x, 0, z) [m] and the angles ``thigh``, ``shin`` [rad] in all legs."""
    return np.r_[x, 0.0, z, 1.0, 0.0, 0.0, 0.0, np.tile([0.0, thigh, shin], 4)]


def height(thigh: float, shin: float) -> float:
    """Return the height [m] of the trunk with all feet on the ground, for the joint angles [rad] of the legs."""
    return LINK * cos(thigh) + LINK * cos(thigh + shin) + FOOT


STANDING = pose(0.0, height(0.8, -1.6), 0.8, -1.6)
"""Pose q (19,) of the robot standing on its feet."""
LYING = pose(0.0, TRUNK[2] + 1e-4, 2.6, -2.6)
"""Pose q (19,) of the robot lying on its belly with folded legs, its feet on the floor."""
CAMERA = PinholeCamera.around((0.25, 0.0, 0.2), 0.75)
"""Camera that shows the default path of the robot."""


class Params(GaitParams):
    """Parameters of ``quadruped``; it jumps if ``rise`` is given, and stands up if ``start=lie``."""

    start: str = choice(("stand", "lie"), "start on its feet, or on its belly with folded legs")


def build(params: Params) -> Problem:
    """Return the problem with steps (quadruped.1), (quadruped.2), contacts (quadruped.3) and cost (quadruped.5).

    Friction is (quadruped.4), the state is (q, v); lam are impulses [N s]."""
    lies = params.start == "lie"
    scaling = Scaling(impulse=1.0, gap=0.1, x=0.1, u=0.3)
    return gait(name, params, quadruped(belly=lies), LYING if lies else STANDING, STANDING, _trot, scaling)


def _trot(share: np.ndarray) -> np.ndarray:
    """Return joint angles (n, 12) [rad] of a trot at fractions (n,) of the path; each diagonal pair is lifted twice."""
    joints = np.zeros((len(share), 12))
    for k, (fore, left) in enumerate(LEGS.values()):
        lift = np.maximum(0.0, np.sin(4 * np.pi * share) * fore * left)
        joints[:, 3 * k + 1], joints[:, 3 * k + 2] = lift, -2 * lift
    return joints


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw trunk, legs and floor."""
    return spatial_shapes(quadruped(), CAMERA, state)


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frames of the feet on the floor, and of the belly if the robot starts on it."""
    return spatial_frames(quadruped(belly=params.start == "lie"), CAMERA, state, params.friction)
