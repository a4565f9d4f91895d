"""A small quadruped of our own: a trunk on four legs of three joints, 12 motors, 12.4 kg."""

from __future__ import annotations

from functools import cache
from math import cos
from typing import Any

import numpy as np

from dynamics.systems.space import (
    Body,
    Box,
    Capsule,
    Plane,
    SpatialMachine,
    SpatialPart,
    Sphere,
)

TRUNK = (0.19, 0.05, 0.05)
THIGH = SHIN = 0.2
FOOT = 0.02
TORQUE = 25.0
_HIP, _SIDE, _OUT = 0.18, 0.047, 0.08
LEGS = {"fl": (1, 1), "fr": (1, -1), "hl": (-1, 1), "hr": (-1, -1)}
"""Fore and hind legs, left and right, as signs along x and y."""


def _rod(length: float, mass: float) -> tuple[float, float, float]:
    """Inertia of a rod of 2 cm that hangs down."""
    long, thick = mass * length**2 / 12, mass * 0.02**2 / 2
    return long, long, thick


@cache
def quadruped(belly: bool = False) -> SpatialMachine:
    """Trunk 6.9 kg, hips 0.7 kg, thighs 0.6 kg, shins 0.1 kg; one unit of input is 25 N m.

    At q = 0 the legs hang straight down; hips turn outward about x, thighs and shins about y. Feet
    are spheres of 2 cm; with ``belly`` the lower corners of the trunk may touch the ground too.
    """
    a, b, c = (2 * half for half in TRUNK)
    mass: float = 6.9
    joint: dict[str, Any] = {"damping": 0.05, "armature": 0.005, "gear": TORQUE}
    bodies = [
        Body(
            "trunk",
            None,
            mass,
            (mass * (b * b + c * c) / 12, mass * (a * a + c * c) / 12, mass * (a * a + b * b) / 12),
            joint="free",
        )
    ]
    parts = [SpatialPart("floor", "world", Plane()), SpatialPart("trunk", "trunk", Box(TRUNK))]
    touching = []
    for leg, (fore, left) in LEGS.items():
        bodies += [
            Body(
                f"{leg}_hip",
                "trunk",
                0.7,
                (7e-4, 9e-4, 7e-4),
                com=(0.0, 0.02 * left, 0.0),
                position=(_HIP * fore, _SIDE * left, 0.0),
                axis=(1.0, 0.0, 0.0),
                limits=(-0.8, 0.8),
                **joint,
            ),
            Body(
                f"{leg}_thigh",
                f"{leg}_hip",
                0.6,
                _rod(THIGH, 0.6),
                com=(0.0, 0.0, -0.05),
                position=(0.0, _OUT * left, 0.0),
                limits=(-1.0, 3.0),
                **joint,
            ),
            Body(
                f"{leg}_shin",
                f"{leg}_thigh",
                0.1,
                _rod(SHIN, 0.1),
                com=(0.0, 0.0, -SHIN / 2),
                position=(0.0, 0.0, -THIGH),
                limits=(-2.7, -0.4),
                **joint,
            ),
        ]
        parts += [
            SpatialPart(f"{leg} hip", f"{leg}_hip", Capsule((0.0, 0.0, 0.0), (0.0, _OUT * left, 0.0), 0.035)),
            SpatialPart(f"{leg} thigh", f"{leg}_thigh", Capsule((0.0, 0.0, 0.0), (0.0, 0.0, -THIGH), 0.02)),
            SpatialPart(f"{leg} shin", f"{leg}_shin", Capsule((0.0, 0.0, 0.0), (0.0, 0.0, -SHIN), 0.012)),
            SpatialPart(leg, f"{leg}_shin", Sphere(FOOT, (0.0, 0.0, -SHIN))),
        ]
        touching.append(leg)
        if belly:
            corner = (fore * TRUNK[0], left * TRUNK[1], -TRUNK[2])
            parts.append(SpatialPart(f"{leg} belly", "trunk", Sphere(0.0, corner)))
            touching.append(f"{leg} belly")
    return SpatialMachine(tuple(bodies), tuple(parts), tuple((one, "floor") for one in touching))


def pose(x: float, z: float, thigh: float, shin: float) -> np.ndarray:
    """q with the trunk level at (x, 0, z) and all legs bent alike (19,)."""
    return np.r_[x, 0.0, z, 1.0, 0.0, 0.0, 0.0, np.tile([0.0, thigh, shin], 4)]


def height(thigh: float, shin: float) -> float:
    """Height of the trunk over feet on the ground [m]."""
    return THIGH * cos(thigh) + SHIN * cos(thigh + shin) + FOOT
