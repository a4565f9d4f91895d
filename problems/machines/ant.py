"""The ant: a ball on four legs of two joints each, as Gymnasium's file ant.xml has it."""

from __future__ import annotations

from functools import cache
from math import pi, radians, sin, sqrt
from typing import Any

import numpy as np

from dynamics.systems.space import Body, Capsule, Plane, SpatialMachine, SpatialPart, Sphere

DENSITY, TORQUE = 5.0, 150.0
_BALL, _TUBE = 0.25, 0.08
LEGS = {"1": (1, 1), "2": (-1, 1), "3": (-1, -1), "4": (1, -1)}
"""Legs by the file's numbers: signs along x and y of where they point."""
_ANKLES = {"1": (30.0, 70.0), "2": (-70.0, -30.0), "3": (-70.0, -30.0), "4": (30.0, 70.0)}
"""Limits of the ankles [degrees], about (-1, 1, 0) of legs 1 and 3 and (1, 1, 0) of 2 and 4."""


def _tube(end: tuple[float, float, float]) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, centre and inertia (3, 3) about it of a capsule of 8 cm from the origin to ``end``."""
    along = np.array(end)
    length = float(np.linalg.norm(along))
    axis, r = along / length, _TUBE
    middle, caps = DENSITY * pi * r**2 * length, DENSITY * 4 / 3 * pi * r**3
    about = middle * r**2 / 2 + caps * 2 / 5 * r**2
    across = middle * (r**2 / 4 + length**2 / 12)
    across += caps * (2 / 5 * r**2 + length**2 / 4 + 3 / 8 * length * r)
    outer = np.outer(axis, axis)
    return middle + caps, along / 2, across * (np.eye(3) - outer) + about * outer


def _three(point: np.ndarray) -> tuple[float, float, float]:
    x, y, z = map(float, point)
    return x, y, z


def _six(inertia: np.ndarray) -> tuple[float, ...]:
    return tuple(float(inertia[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))


@cache
def ant() -> SpatialMachine:
    """Gymnasium's ant, 14 velocities and 8 motors; one unit of input is 150 N m.

    The torso carries the inner tubes of the legs, "aux" of the file, which are inside of what
    touches first: ground contacts are those of the torso, of the knees and of the feet.
    """
    ball = DENSITY * 4 / 3 * pi * _BALL**3
    tubes = [_tube((0.2 * x, 0.2 * y, 0.0)) for x, y in LEGS.values()]
    spread = sum(
        (own + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre)) for mass, centre, own in tubes),
        ball * 2 / 5 * _BALL**2 * np.eye(3),
    )
    torso = ball + sum(mass for mass, *_ in tubes)
    bodies = [Body("torso", None, torso, _six(spread), joint="free")]
    parts = [
        SpatialPart("floor", "world", Plane()),
        SpatialPart("torso", "torso", Sphere(_BALL)),
    ]
    joint: dict[str, Any] = {"damping": 1.0, "armature": 1.0, "gear": TORQUE}
    for leg, (x, y) in LEGS.items():
        thigh, shank = (0.2 * x, 0.2 * y, 0.0), (0.4 * x, 0.4 * y, 0.0)
        low, high = (radians(v) for v in _ANKLES[leg])
        mass, centre, inertia = _tube(thigh)
        hip = Body(
            f"hip_{leg}",
            "torso",
            mass,
            _six(inertia),
            com=_three(centre),
            position=thigh,
            axis=(0.0, 0.0, 1.0),
            limits=(-pi / 6, pi / 6),
            **joint,
        )
        mass, centre, inertia = _tube(shank)
        side = -x * y / sqrt(2)
        ankle = Body(
            f"ankle_{leg}",
            f"hip_{leg}",
            mass,
            _six(inertia),
            com=_three(centre),
            position=thigh,
            axis=(side, 1 / sqrt(2), 0.0),
            limits=(low, high),
            **joint,
        )
        bodies += [hip, ankle]
        parts += [
            SpatialPart(f"leg {leg}", f"hip_{leg}", Capsule((0.0, 0.0, 0.0), thigh, _TUBE)),
            SpatialPart(f"knee {leg}", f"ankle_{leg}", Sphere(_TUBE)),
            SpatialPart(f"foot {leg}", f"ankle_{leg}", Sphere(_TUBE, shank)),
            SpatialPart(f"shank {leg}", f"ankle_{leg}", Capsule((0.0, 0.0, 0.0), shank, _TUBE)),
        ]
    touching = [part.name for part in parts if part.name.split()[0] in ("torso", "knee", "foot")]
    return SpatialMachine(tuple(bodies), tuple(parts), tuple((one, "floor") for one in touching))


def standing(bend: float = 1.0) -> np.ndarray:
    """q of the ant on its four feet, ankles bent by ``bend`` [rad] (15,)."""
    q = np.zeros(15)
    q[2], q[3] = 0.4 * sqrt(2) * sin(bend) + _TUBE, 1.0
    q[8::2] = [bend if low > 0 else -bend for low, _ in _ANKLES.values()]
    return q
