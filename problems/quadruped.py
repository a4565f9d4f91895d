"""A quadruped in space: trot, stand up from the floor, or jump."""

from __future__ import annotations

import numpy as np

from ocp.problem.problem import Problem, Scaling
from problems.drawing import ContactFrame, Shape
from problems.machines.gait import STEPS, GaitParams, gait
from problems.machines.perspective import Camera
from problems.machines.quadruped import LEGS, TRUNK, height, pose
from problems.machines.quadruped import quadruped as machine_of
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
        0.11396704079,
        settings={"strategy": "scholtes"},
        tried=3,
        note="other minima: 0.1228544, 0.1250533",
    )
}
_THIGH, _SHIN, _FOLDED = 0.8, -1.6, 2.6
"""Angles of a leg that stands, and of a folded one, whose foot is on the floor beside the belly."""
_STANDS = pose(0.0, height(_THIGH, _SHIN), _THIGH, _SHIN)
_LIES = pose(0.0, TRUNK[2] + 1e-4, _FOLDED, -_FOLDED)
_CAMERA = Camera.around((0.25, 0.0, 0.2), 0.75)


class Params(GaitParams):
    """Parameters of ``quadruped``: to jump, give a ``rise``; to stand up, ``start=lie``."""

    start: str = choice(("stand", "lie"), "on its feet, or on its belly with folded legs")


def build(params: Params) -> Problem:
    """Steps (quadruped.1) on the tangent space (quadruped.2) with contacts (quadruped.3) and
    friction (quadruped.4), cost (quadruped.5); state (q, v), impulses lam [N s]."""
    lies = params.start == "lie"
    return gait(
        name,
        params,
        machine_of(belly=lies),
        _LIES if lies else _STANDS,
        _STANDS,
        _trot,
        Scaling(impulse=1.0, gap=0.1, x=0.1, u=0.3),
    )


def _trot(share: np.ndarray) -> np.ndarray:
    """Diagonal legs are lifted in turn, twice each."""
    joints = np.zeros((len(share), 12))
    for k, (fore, left) in enumerate(LEGS.values()):
        lift = np.maximum(0.0, np.sin(4 * np.pi * share) * fore * left)
        joints[:, 3 * k + 1], joints[:, 3 * k + 2] = lift, -2 * lift
    return joints


def draw(params: Params, state: np.ndarray) -> list[Shape]:
    """Trunk, legs and the floor."""
    return spatial_shapes(machine_of(), _CAMERA, state)


def frames(params: Params, state: np.ndarray) -> list[ContactFrame]:
    """Contacts with the floor."""
    machine = machine_of(belly=params.start == "lie")
    return spatial_frames(machine, _CAMERA, state, params.friction)
