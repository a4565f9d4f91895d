"""Test whether two geoms of a compiled file can touch in any pose within the joint limits."""

from __future__ import annotations

import math
from importlib import import_module
from itertools import product
from typing import Any

import numpy as np

POSES_TRIED = 128
"""Maximum number of poses at which the distance of two geoms is measured."""
LONGEST_DISTANCE_M = 1e4
"""Maximum distance of two geoms that is measured [m]."""
PARALLEL_TOLERANCE = 1e-9
"""Sine of the angle between axes that count as parallel, and relative difference of equal lengths."""


def never_collide(model: Any, data: Any, above: list[list[int]], first_geom: int, second_geom: int) -> bool:
    """Return whether two geoms can never touch; False also if this could not be decided.

    ``above`` is the result of :func:`joints_above`; ``data`` is overwritten. The ranges of the joints
    between the geoms are divided into pieces. The geoms never touch if, at the middle of every piece,
    their distance exceeds the motion that the joints can cause within the piece, or if they move in
    parallel planes some distance apart.
    """
    mujoco, geoms = import_module("mujoco"), (first_geom, second_geom)
    chains = [above[model.geom_bodyid[g]] for g in geoms]
    shared = set(chains[0]) & set(chains[1])
    chains = [[j for j in chain if j not in shared] for chain in chains]
    joints = [j for chain in chains for j in chain]
    if _beside(model, data, joints, geoms):
        return True
    ranges = np.array([_range(model, j) for j in joints]).reshape(-1, 2)
    if not np.isfinite(ranges).all():
        return False
    n_pieces = int(POSES_TRIED ** (1 / max(1, len(joints))))
    half_widths = np.ptp(ranges, axis=1) / (2 * n_pieces)
    widths = dict(zip(joints, half_widths, strict=True))
    for numbers in product(range(1, 2 * n_pieces, 2), repeat=len(joints)):
        data.qpos[model.jnt_qposadr[joints]] = ranges[:, 0] + half_widths * numbers
        mujoco.mj_kinematics(model, data)
        reach = 0.0
        for g, chain in zip(geoms, chains, strict=True):
            radius = 0.0
            # From the last joint to the first: each joint also moves the motion of the joints before it.
            for j in chain:
                arm = math.dist(data.xanchor[j], data.geom_xpos[g]) + model.geom_rbound[g]
                radius += widths[j] * (1 if model.jnt_type[j] == 2 else arm + radius)
            reach += radius
        if mujoco.mj_geomDistance(model, data, first_geom, second_geom, LONGEST_DISTANCE_M, None) <= reach:
            return False
    return True


def _beside(model: Any, data: Any, joints: list[int], geoms: tuple[int, int]) -> bool:
    """Return whether all hinges between two geoms are parallel, and the geoms are separate along the hinges' axis."""
    data.qpos[:] = model.qpos0
    import_module("mujoco").mj_kinematics(model, data)
    hinges = [j for j in joints if model.jnt_type[j] == 3]
    if not hinges or any(model.jnt_type[j] < 2 for j in joints) or 0 in model.geom_type[[*geoms]]:
        return False
    axis = data.xaxis[hinges[0]].copy()
    tilt = np.abs(np.cross(data.xaxis[hinges], axis)).max()
    slid = np.abs([data.xaxis[j] @ axis for j in joints if model.jnt_type[j] == 2]).max(initial=0.0)
    middles, halves = list[float](), list[float]()
    for g in geoms:
        local_axis = data.geom_xmat[g].reshape(3, 3).T @ axis
        middles.append(data.geom_xpos[g] @ axis + local_axis @ model.geom_aabb[g, :3])
        halves.append(np.abs(local_axis) @ model.geom_aabb[g, 3:])
    gap = abs(middles[0] - middles[1]) - sum(halves)
    return max(tilt, slid) < PARALLEL_TOLERANCE and gap > PARALLEL_TOLERANCE * (sum(halves) + abs(middles[0]))


def joints_above(model: Any) -> list[list[int]]:
    """Return, for each body, the list of the joints that move it, from its own joints to those of the root."""
    moving: list[list[int]] = [[]]
    for body in range(1, model.nbody):
        joints = np.flatnonzero(model.jnt_bodyid == body)[::-1].tolist()
        moving.append(joints + moving[model.body_parentid[body]])
    return moving


def _range(model: Any, j: int) -> tuple[float, float]:
    """Return the range of a joint; without limits it is a whole turn for a hinge, and infinite for other joints."""
    if model.jnt_limited[j] and model.jnt_type[j] > 1:
        return tuple(model.jnt_range[j].tolist())
    return (-math.pi, math.pi) if model.jnt_type[j] == 3 else (-math.inf, math.inf)
