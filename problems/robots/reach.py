"""Which geoms of a compiled file can never meet, whatever joints do within their limits."""

from __future__ import annotations

import math
from importlib import import_module
from itertools import product
from typing import Any

import numpy as np

_POSES, _FAR = 128, 1e4
"""Poses that are tried of two geoms, and the longest distance that is measured [m]."""


def apart(model: Any, data: Any, one: int, other: int) -> bool:
    """Whether two geoms can never meet; False where that is not known. ``data`` is overwritten.

    The ranges of the joints between them are cut into pieces. They never meet if they are further
    apart in the middle of every piece than the joints can move them within it.
    """
    mujoco, geoms = import_module("mujoco"), (one, other)
    ways = [_above(model, int(model.geom_bodyid[g])) for g in geoms]
    ways = [[j for j in way if j not in ways[0] or j not in ways[1]] for way in ways]
    joints = [j for way in ways for j in way]
    ranges = np.array([_range(model, j) for j in joints]).reshape(-1, 2)
    if not np.isfinite(ranges).all():
        return False
    pieces = int(_POSES ** (1 / max(1, len(joints))))
    half = np.ptp(ranges, axis=1) / (2 * pieces)
    widths = dict(zip(joints, half, strict=True))
    for numbers in product(range(1, 2 * pieces, 2), repeat=len(joints)):
        data.qpos[model.jnt_qposadr[joints]] = ranges[:, 0] + half * numbers
        mujoco.mj_kinematics(model, data)
        moved = 0.0
        for g, way in zip(geoms, ways, strict=True):
            far = 0.0
            # From the last joint to the first, each moves what those before it have moved.
            for j in way:
                arm = math.dist(data.xanchor[j], data.geom_xpos[g]) + model.geom_rbound[g]
                far += widths[j] * (1 if model.jnt_type[j] == 2 else arm + far)
            moved += far
        if mujoco.mj_geomDistance(model, data, one, other, _FAR, None) <= moved:
            return False
    return True


def _above(model: Any, body: int) -> list[int]:
    """The joints that move a body, its own first."""
    own = np.flatnonzero(model.jnt_bodyid == body)[::-1].tolist()
    return own + _above(model, int(model.body_parentid[body])) if body else own


def _range(model: Any, j: int) -> tuple[float, float]:
    """Where a hinge or a slide may be; without end for all other joints."""
    if model.jnt_limited[j] and model.jnt_type[j] > 1:
        return tuple(model.jnt_range[j].tolist())
    return (-math.pi, math.pi) if model.jnt_type[j] == 3 else (-math.inf, math.inf)
