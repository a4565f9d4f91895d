"""Which geoms of a compiled file can never meet, whatever joints do within their limits."""

from __future__ import annotations

import math
from importlib import import_module
from itertools import product
from typing import Any

import numpy as np

POSES_TRIED = 128
"""Most poses of two geoms at which their distance is measured."""
LONGEST_DISTANCE_M = 1e4
"""Longest distance of two geoms that is measured [m]."""
PARALLEL_TOLERANCE = 1e-9
"""Sine of the angle between axes that count as parallel, and relative difference of equal lengths."""


def never_collide(model: Any, data: Any, above: list[list[int]], one: int, other: int) -> bool:
    """Whether two geoms can never meet; False where that is not known.

    ``above`` has the joints that move each body; ``data`` is overwritten.
    The ranges of the joints between them are cut into pieces. They never meet if they are further
    apart in the middle of every piece than the joints can move them within it, or if they move in
    parallel planes, beside each other.
    """
    mujoco, geoms = import_module("mujoco"), (one, other)
    ways = [above[model.geom_bodyid[g]] for g in geoms]
    shared = set(ways[0]) & set(ways[1])
    ways = [[j for j in way if j not in shared] for way in ways]
    joints = [j for way in ways for j in way]
    if _beside(model, data, joints, geoms):
        return True
    ranges = np.array([_range(model, j) for j in joints]).reshape(-1, 2)
    if not np.isfinite(ranges).all():
        return False
    pieces = int(POSES_TRIED ** (1 / max(1, len(joints))))
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
        if mujoco.mj_geomDistance(model, data, one, other, LONGEST_DISTANCE_M, None) <= moved:
            return False
    return True


def _beside(model: Any, data: Any, joints: list[int], geoms: tuple[int, int]) -> bool:
    """Whether boxes around two geoms are apart along the one axis about which all joints turn."""
    data.qpos[:] = model.qpos0
    import_module("mujoco").mj_kinematics(model, data)
    hinges = [j for j in joints if model.jnt_type[j] == 3]
    if not hinges or any(model.jnt_type[j] < 2 for j in joints) or 0 in model.geom_type[[*geoms]]:
        return False
    axis = data.xaxis[hinges[0]].copy()
    turned = np.abs(np.cross(data.xaxis[hinges], axis)).max()
    slid = np.abs([data.xaxis[j] @ axis for j in joints if model.jnt_type[j] == 2]).max(initial=0.0)
    middles, halves = list[float](), list[float]()
    for g in geoms:
        along = data.geom_xmat[g].reshape(3, 3).T @ axis
        middles.append(data.geom_xpos[g] @ axis + along @ model.geom_aabb[g, :3])
        halves.append(np.abs(along) @ model.geom_aabb[g, 3:])
    gap = abs(middles[0] - middles[1]) - sum(halves)
    return max(turned, slid) < PARALLEL_TOLERANCE and gap > PARALLEL_TOLERANCE * (sum(halves) + abs(middles[0]))


def joints_above(model: Any) -> list[list[int]]:
    """Return the joints that move each body, its own first."""
    moving: list[list[int]] = [[]]
    for body in range(1, model.nbody):
        own = np.flatnonzero(model.jnt_bodyid == body)[::-1].tolist()
        moving.append(own + moving[model.body_parentid[body]])
    return moving


def _range(model: Any, j: int) -> tuple[float, float]:
    """Range of a hinge or a slide; without end for all other joints."""
    if model.jnt_limited[j] and model.jnt_type[j] > 1:
        return tuple(model.jnt_range[j].tolist())
    return (-math.pi, math.pi) if model.jnt_type[j] == 3 else (-math.inf, math.inf)
