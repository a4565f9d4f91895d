"""Gymnasium's ant walks: a ball on four legs of two joints each, as the file ant.xml has it."""

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
"""Legs by the file's numbers: signs along x and y of where they point."""
ANKLES = {"1": (30.0, 70.0), "2": (-70.0, -30.0), "3": (-70.0, -30.0), "4": (30.0, 70.0)}
"""Limits of the ankles [degrees], about (-1, 1, 0) of legs 1 and 3 and (1, 1, 0) of 2 and 4."""
MOTOR: dict[str, Any] = {"damping": 1.0, "armature": 1.0, "gear": 150.0}
"""Damping [N m s/rad], armature [kg m^2] and torque of one unit of input [N m] of every joint."""
CAMERA = PinholeCamera.around((0.2, 0.0, 0.3), 1.4)
"""View of the way that the ant goes by default."""


def _tube(end: tuple[float, float, float]) -> tuple[float, np.ndarray, np.ndarray]:
    """Return mass, centre and inertia (3, 3) about it of a capsule of 8 cm from the origin to ``end``."""
    to_end = np.array(end)
    length = float(np.linalg.norm(to_end))
    axis, r = to_end / length, TUBE
    middle, caps = DENSITY * pi * r**2 * length, DENSITY * 4 / 3 * pi * r**3
    about = middle * r**2 / 2 + caps * 2 / 5 * r**2
    across = middle * (r**2 / 4 + length**2 / 12)
    across += caps * (2 / 5 * r**2 + length**2 / 4 + 3 / 8 * length * r)
    outer = np.outer(axis, axis)
    return middle + caps, to_end / 2, across * (np.eye(3) - outer) + about * outer


def _six_entries(inertia: np.ndarray) -> tuple[float, ...]:
    return tuple(float(inertia[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))


def _limb(name: str, parent: str, position: Any, end: Any, axis: Any, limits: tuple[float, float]) -> Body:
    """Return a tube from the joint at ``position`` to ``end`` [m], in the joint's frame."""
    mass, centre, inertia = _tube(end)
    x, y, z = map(float, centre)
    return Body(name, parent, mass, _six_entries(inertia), (x, y, z), position, axis=axis, limits=limits, **MOTOR)


@cache
def ant() -> SpatialMachine:
    """Return Gymnasium's ant, 14 velocities and 8 motors; one unit of input is 150 N m.

    The torso carries the inner tubes of the legs, "aux" of the file, which are inside of what
    touches first: ground contacts are those of the torso, of the knees and of the feet.
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


def standing_pose(bend: float = 1.0) -> np.ndarray:
    """Return q of the ant on its four feet, ankles bent by ``bend`` [rad] (15,)."""
    q = np.zeros(15)
    q[2], q[3] = 0.4 * sqrt(2) * sin(bend) + TUBE, 1.0
    q[8::2] = [bend if low > 0 else -bend for low, _ in ANKLES.values()]
    return q


class Params(GaitParams):
    """Parameters of ``ant``; the file has h = 0.01 s, and an input holds for five of its steps."""

    friction: float = quantity(1.0, "1", "Coulomb's coefficient with the ground", above=0)
    h: float = quantity(0.05, "s", "step size", above=0)
    w_u: float = quantity(0.2, "1/s", "weight of the inputs", least=0)
    w_v: float = quantity(0.05, "s/m^2", "weight of the velocities", least=0)


def build(params: Params) -> Problem:
    """Steps (ant.1) on the tangent space (ant.2) with contacts (ant.3) and friction (ant.4), cost
    (ant.5); state (q, v), impulses lam [N s]."""
    scaling = Scaling(impulse=0.1, gap=0.1, x=0.1, u=0.1)
    return gait(name, params, ant(), standing_pose(), standing_pose(), _walk, scaling)


def _walk(share: np.ndarray) -> np.ndarray:
    """Return the joints (n, 8) of a walk: hips swing to and fro, diagonal legs alike."""
    joints = np.zeros((len(share), 8))
    for k, (x, y) in enumerate(LEGS.values()):
        joints[:, 2 * k] = 0.3 * np.sin(4 * np.pi * share) * x * y
    return joints


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Draw torso, legs and the floor."""
    return spatial_shapes(ant(), CAMERA, state)


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Return the frames of the contacts with the floor."""
    return spatial_frames(ant(), CAMERA, state, params.friction)
