"""Gymnasium's ant, a walking robot: a ball on four legs with two joints each, with the values of ant.xml."""

from __future__ import annotations

from functools import cache
from math import pi, radians, sin, sqrt
from typing import Any

import numpy as np

from dynamics.systems.space import Body, Capsule, Plane, SpatialMachine, SpatialPart, Sphere
from ocp.problem.problem import Problem, Scaling
from problems.drawing import ContactFrame, Shape
from problems.machines.gait import STEPS, GaitParams, gait
from problems.machines.perspective import PinholeCamera
from problems.machines.spatial import AXES, spatial_frames, spatial_shapes
from problems.parameters import quantity
from problems.spec import Citation, Golden

name = "ant"
title = "Ant: walk"
citation = Citation("schulman2016high", "where the ant comes from; the table of Gymnasium's ant.xml")
axes = AXES
equations = STEPS
golden = {"exact": Golden(0.12040724552, settings={"strategy": "scholtes"}, tried=3, note="another minimum: 0.1289853")}
DENSITY = 5.0
"""Density of the torso and the legs [kg/m^3]."""
BALL = 0.25
"""Radius of the torso [m]."""
TUBE = 0.08
"""Radius of the legs [m]."""
LEGS = {"1": (1, 1), "2": (-1, 1), "3": (-1, -1), "4": (1, -1)}
"""Mapping from a leg's number in ant.xml to the signs of its direction along x and y."""
ANKLES = {"1": (30.0, 70.0), "2": (-70.0, -30.0), "3": (-70.0, -30.0), "4": (30.0, 70.0)}
"""Limits of the ankles [degrees]; ankles turn about (-1, 1, 0) in legs 1 and 3, (1, 1, 0) in legs 2 and 4."""
MOTOR: dict[str, Any] = {"damping": 1.0, "armature": 1.0, "gear": 150.0}
"""Damping [N m s/rad], armature [kg m^2] and torque of one unit of input [N m] of every joint."""
CAMERA = PinholeCamera.around((0.2, 0.0, 0.3), 1.4)
"""Camera that shows the default path of the ant."""


def _tube(end: tuple[float, float, float]) -> tuple[float, np.ndarray, np.ndarray]:
    """Return mass [kg], centre [m] and central inertia (3, 3) [kg m^2] of a leg's capsule from the joint to ``end``."""
    to_end = np.array(end)
    length = float(np.linalg.norm(to_end))
    axis, r = to_end / length, TUBE
    middle, caps = DENSITY * pi * r**2 * length, DENSITY * 4 / 3 * pi * r**3
    about = middle * r**2 / 2 + caps * 2 / 5 * r**2
    transverse = middle * (r**2 / 4 + length**2 / 12)
    transverse += caps * (2 / 5 * r**2 + length**2 / 4 + 3 / 8 * length * r)
    outer = np.outer(axis, axis)
    return middle + caps, to_end / 2, transverse * (np.eye(3) - outer) + about * outer


def _six_entries(inertia: np.ndarray) -> tuple[float, ...]:
    return tuple(float(inertia[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))


def _limb(name: str, parent: str, position: Any, end: Any, axis: Any, limits: tuple[float, float]) -> Body:
    """Return a capsule from a hinge at ``position`` in the parent's frame to ``end`` in its own frame [m]."""
    mass, centre, inertia = _tube(end)
    x, y, z = map(float, centre)
    return Body(name, parent, mass, _six_entries(inertia), (x, y, z), position, axis=axis, limits=limits, **MOTOR)


@cache
def ant() -> SpatialMachine:
    """Return Gymnasium's ant, with 14 velocities and 8 motors; one unit of input is 150 N m.

    The inner capsules of the legs, "aux" in the file, are part of the torso and have no contacts,
    since other parts touch the ground first: the torso, the knees and the feet.
    """
    ball = DENSITY * 4 / 3 * pi * BALL**3
    tubes = [_tube((0.2 * x, 0.2 * y, 0.0)) for x, y in LEGS.values()]
    spread = sum(
        (inertia + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre)) for mass, centre, inertia in tubes),
        ball * 2 / 5 * BALL**2 * np.eye(3),
    )
    torso = ball + sum(mass for mass, *_ in tubes)
    bodies = [Body("torso", None, torso, _six_entries(spread), joint="free")]
    parts = [SpatialPart("floor", "world", Plane()), SpatialPart("torso", "torso", Sphere(BALL))]
    for leg, (x, y) in LEGS.items():
        hip, ankle = f"hip_{leg}", f"ankle_{leg}"
        thigh, shank = (0.2 * x, 0.2 * y, 0.0), (0.4 * x, 0.4 * y, 0.0)
        low, high = (radians(angle) for angle in ANKLES[leg])
        bodies += [
            _limb(hip, "torso", thigh, thigh, (0.0, 0.0, 1.0), (-pi / 6, pi / 6)),
            _limb(ankle, hip, thigh, shank, (-x * y / sqrt(2), 1 / sqrt(2), 0.0), (low, high)),
        ]
        parts += [
            SpatialPart(f"leg {leg}", hip, Capsule((0.0, 0.0, 0.0), thigh, TUBE)),
            SpatialPart(f"knee {leg}", ankle, Sphere(TUBE)),
            SpatialPart(f"foot {leg}", ankle, Sphere(TUBE, shank)),
            SpatialPart(f"shank {leg}", ankle, Capsule((0.0, 0.0, 0.0), shank, TUBE)),
        ]
    touching = [part.name for part in parts if part.name.split()[0] in ("torso", "knee", "foot")]
    return SpatialMachine(tuple(bodies), tuple(parts), tuple((part, "floor") for part in touching))


def standing_pose() -> np.ndarray:
    """Return the pose q (15,) of the ant standing on its four feet, with ankles bent by 1 rad."""
    q = np.zeros(15)
    q[2], q[3] = 0.4 * sqrt(2) * sin(1.0) + TUBE, 1.0
    q[8::2] = [1.0 if low > 0 else -1.0 for low, _ in ANKLES.values()]
    return q


class Params(GaitParams):
    """Parameters of ``ant``; the default h is five steps of 0.01 s, the time for which the source holds an input."""

    friction: float = quantity(1.0, "1", "Coulomb's coefficient with the ground", above=0)
    h: float = quantity(0.05, "s", "step size", above=0)
    w_u: float = quantity(0.2, "1/s", "weight of the inputs", least=0)
    w_v: float = quantity(0.05, "s/m^2", "weight of the velocities", least=0)


def build(params: Params) -> Problem:
    """Return the problem with the steps (ant.1) and (ant.2), contacts (ant.3), friction (ant.4) and cost (ant.5).

    The state is (q, v); lam are impulses [N s]."""
    scaling = Scaling(impulse=0.1, gap=0.1, x=0.1, u=0.1)
    return gait(name, params, ant(), standing_pose(), standing_pose(), _walk, scaling)


def _walk(share: np.ndarray) -> np.ndarray:
    """Return joint angles (n, 8) [rad] at fractions (n,) of the path: hips swing, diagonal legs in phase."""
    joints = np.zeros((len(share), 8))
    for k, (x, y) in enumerate(LEGS.values()):
        joints[:, 2 * k] = 0.3 * np.sin(4 * np.pi * share) * x * y
    return joints


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw torso, legs and floor."""
    return spatial_shapes(ant(), CAMERA, state)


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Return the contact frames of torso, knees and feet on the floor."""
    return spatial_frames(ant(), CAMERA, state, params.friction)
