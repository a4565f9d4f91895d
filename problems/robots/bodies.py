"""Bodies and joints of a compiled file as bodies in space, one for each joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dynamics.systems.space import Body
from dynamics.systems.space.body import POSITIONS, Joint, Quaternion, Vector
from problems.robots.source import listed
from problems.robots.tree import Motor, body_name, joint_name, motors_of

_ROUNDING = 1e-12
_JOINTS: tuple[Joint, ...] = ("free", "ball", "slide", "hinge")
"""Joints in the order of MuJoCo's numbers."""


@dataclass(frozen=True)
class Pose:
    """Where a frame is in another: its origin ``place`` (3,) [m], and the ``turn`` of its axes."""

    place: np.ndarray
    turn: Rotation

    def __matmul__(self, inner: Pose) -> Pose:
        return Pose(self.place + self.turn.apply(inner.place), self.turn * inner.turn)


@dataclass(frozen=True)
class Carrier:
    """The body in space that a body of the file is part of, and the pose in its frame."""

    name: str
    pose: Pose


@dataclass(frozen=True)
class SpatialTree:
    """Bodies in the order of q, who carries each body of the file, and a joint for every entry."""

    bodies: tuple[Body, ...]
    carriers: dict[int, Carrier]
    joints: tuple[str, ...]
    motors: tuple[Motor, ...]
    ignored: tuple[str, ...]


def turn_of(quaternion: np.ndarray) -> Rotation:
    """A rotation of MuJoCo's quaternion (w, x, y, z)."""
    return Rotation.from_quat(quaternion, scalar_first=True)


def exact(values: Sequence[float] | np.ndarray, size: float = 1.0) -> tuple[float, ...]:
    """Numbers without what rounding leaves of 0 and of ±1, for sizes about ``size``."""
    found = (0.0 if abs(value) < _ROUNDING * size else float(value) for value in values)
    return tuple(float(round(x)) if abs(abs(x) - 1) < _ROUNDING else x for x in found)


def point(values: np.ndarray) -> Vector:
    """Three numbers, rounded where that is :func:`exact`."""
    x, y, z = exact(values)
    return x, y, z


def quaternion(turn: Rotation) -> Quaternion:
    """A rotation as (w, x, y, z) with w >= 0, rounded where that is :func:`exact`."""
    w, x, y, z = exact(turn.as_quat(canonical=True, scalar_first=True))
    return w, x, y, z


def bodies(model: Any) -> SpatialTree:
    """Take over all bodies that move; what is fixed to one is part of it.

    A body with several joints becomes a chain, all but the last of it without mass and named as
    their joints. Each frame has
    its origin in its joint and the axes of the file's body.
    Raises ``ValueError`` for a joint with two motors.
    """
    carriers = {0: Carrier("world", Pose(np.zeros(3), Rotation.identity()))}
    found: list[Body] = []
    last: dict[int, int] = {}
    motors, names = motors_of(model), {body_name(model, b) for b in range(model.nbody)}
    for b in range(1, model.nbody):
        above = carriers[int(model.body_parentid[b])]
        parent = above.name
        pose = above.pose @ Pose(model.body_pos[b], turn_of(model.body_quat[b]))
        if model.body_weldid[b] == b:
            first = int(model.body_jntadr[b])
            for j in range(first, first + int(model.body_jntnum[b])):
                name = body_name(model, b)
                if j < first + int(model.body_jntnum[b]) - 1:
                    name = joint_name(model, j)
                    while name in names:
                        name += "'"
                    names.add(name)
                found.append(_body(model, j, name, parent, pose, motors.get(j)))
                parent, pose = name, Pose(-model.jnt_pos[j], Rotation.identity())
            last[b] = len(found) - 1
        carriers[b] = Carrier(parent, pose)
    for b, index in last.items():
        found[index] = replace(found[index], **_inertia(model, b, carriers))
    kinds = [_JOINTS[kind] for kind in model.jnt_type]
    joints = [joint_name(model, j) for j, kind in enumerate(kinds) for _ in range(POSITIONS[kind])]
    return SpatialTree(
        tuple(found), carriers, tuple(joints), tuple(motors[j] for j in sorted(motors)),
        tuple(_unused(model, kinds)),
    )  # fmt: skip


def _body(model: Any, j: int, name: str, parent: str, pose: Pose, motor: Motor | None) -> Body:
    """The body of a joint, without mass; ``pose`` is that of the file's body in the parent."""
    kind, dof, at = _JOINTS[model.jnt_type[j]], int(model.jnt_dofadr[j]), int(model.jnt_qposadr[j])
    above = None if parent == "world" else parent
    damping = float(model.dof_damping[dof])
    if kind == "free":
        return Body(name, above, 0.0, joint=kind, damping=damping)
    pose = pose @ Pose(model.jnt_pos[j], Rotation.identity())
    if kind == "ball":
        turn, place = quaternion(pose.turn), point(pose.place)
        return Body(name, above, 0.0, joint=kind, damping=damping, place=place, turn=turn)
    axis, q0, none = np.array(point(model.jnt_axis[j])), float(model.qpos0[at]), np.zeros(3)
    back = Pose(-q0 * axis, Rotation.identity()) if kind == "slide" else (
        Pose(none, Rotation.from_rotvec(-q0 * axis)))  # fmt: skip
    pose = pose @ back
    low, high = model.jnt_range[j].tolist()
    return Body(
        name, above, 0.0, place=point(pose.place), turn=quaternion(pose.turn), joint=kind,
        axis=point(axis), spring=float(model.jnt_stiffness[j]),
        rest=float(model.qpos_spring[at]) if model.jnt_stiffness[j] else 0.0,
        damping=damping, armature=float(model.dof_armature[dof]),
        limits=(low, high) if model.jnt_limited[j] else None,
        gear=None if motor is None else motor.gear,
    )  # fmt: skip


def _inertia(model: Any, body: int, carriers: dict[int, Carrier]) -> dict[str, Any]:
    """Mass, inertia and centre of all that is welded to a body, in the frame of its carrier."""
    parts = [b for b in range(1, model.nbody) if model.body_weldid[b] == body]
    masses = model.body_mass[parts]
    poses = [
        carriers[b].pose @ Pose(model.body_ipos[b], turn_of(model.body_iquat[b])) for b in parts
    ]
    total = float(masses.sum())
    centre = masses @ np.array([pose.place for pose in poses]) / (total or 1)
    inertia = np.zeros((3, 3))
    for b, mass, pose in zip(parts, masses, poses, strict=True):
        R, off = pose.turn.as_matrix(), pose.place - centre
        inertia += R @ np.diag(model.body_inertia[b]) @ R.T
        inertia += mass * (off @ off * np.eye(3) - np.outer(off, off))
    six = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    rounded = exact(six, float(np.trace(inertia)))
    return {"mass": total, "inertia": rounded, "com": point(centre)}


def _unused(model: Any, kinds: list[Joint]) -> list[str]:
    """What free and ball joints of the file have and ours have not."""
    told = {
        "armature": model.dof_armature[model.jnt_dofadr] != 0,
        "spring": model.jnt_stiffness != 0,
        "limit": model.jnt_limited != 0,
    }
    return [
        f"{what} of {listed('joint', own)}: only hinges and slides have one"
        for what, has in told.items()
        if (own := [joint_name(model, j) for j, kind in enumerate(kinds)
                    if has[j] and kind in ("free", "ball")])
    ]  # fmt: skip
