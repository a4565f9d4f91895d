"""Gymnasium's ant, a ball on four legs, walks."""

from __future__ import annotations

import numpy as np

from ocp.problem.problem import Problem, Scaling
from problems.drawing import ContactFrame, Shape
from problems.machines.ant import LEGS, standing
from problems.machines.ant import ant as machine_of
from problems.machines.gait import STEPS, GaitParams, gait
from problems.machines.perspective import Camera
from problems.machines.spatial import AXES, spatial_frames, spatial_shapes
from problems.parameters import quantity
from problems.spec import Citation, Golden

name = "ant"
title = "Ant: walk"
citation = Citation("schulman2016high", "where the ant comes from; the table of Gymnasium's ant.xml")
axes = AXES
equations = STEPS
golden = {"exact": Golden(0.12040724552, settings={"strategy": "scholtes"}, tried=3, note="another minimum: 0.1289853")}
_CAMERA = Camera.around((0.2, 0.0, 0.3), 1.4)


class Params(GaitParams):
    """Parameters of ``ant``; the file has h = 0.01 s, and an input holds for five of its steps."""

    friction: float = quantity(1.0, "1", "Coulomb's coefficient with the ground", above=0)
    h: float = quantity(0.05, "s", "step size", above=0)
    w_u: float = quantity(0.2, "1/s", "weight of the inputs", least=0)
    w_v: float = quantity(0.05, "s/m^2", "weight of the velocities", least=0)


def build(params: Params) -> Problem:
    """Steps (ant.1) on the tangent space (ant.2) with contacts (ant.3) and friction (ant.4), cost
    (ant.5); state (q, v), impulses lam [N s]."""
    return gait(name, params, machine_of(), standing(), standing(), _walk, Scaling(impulse=0.1, gap=0.1, x=0.1, u=0.1))


def _walk(share: np.ndarray) -> np.ndarray:
    """Hips swing to and fro, diagonal legs alike."""
    joints = np.zeros((len(share), 8))
    for k, (x, y) in enumerate(LEGS.values()):
        joints[:, 2 * k] = 0.3 * np.sin(4 * np.pi * share) * x * y
    return joints


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Torso, legs and the floor."""
    return spatial_shapes(machine_of(), _CAMERA, state)


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Contacts with the floor."""
    return spatial_frames(machine_of(), _CAMERA, state, params.friction)
