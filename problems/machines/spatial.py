"""Pictures of a machine in space: its parts and contacts at one state, as seen by a camera."""

from __future__ import annotations

from collections.abc import Collection
from functools import cache

import casadi as ca
import numpy as np

from dynamics.systems.space import WORLD, SpatialMachine
from problems.drawing import ContactFrame, Shape
from problems.machines.perspective import PinholeCamera, Solid, frame_seen, solids_seen

AXES = ("", "")
"""Labels of the axes; they are empty since a picture in perspective has no axes."""


def spatial_shapes(
    machine: SpatialMachine,
    camera: PinholeCamera,
    state: np.ndarray,
    actuators: Collection[str] = (),
    goals: Collection[str] = (),
) -> list[Shape]:
    """Draw all parts at ``state`` (q, v, ...); parts of bodies in ``actuators`` or ``goals`` have that role."""
    poses = np.array(_poses(machine)(_of_unit_length(machine, state))).T
    solids: list[Solid] = []
    for part, pose in zip(machine.parts, poses, strict=True):
        role = "environment" if part.body == WORLD else "object"
        role = "actuator" if part.body in actuators else "goal" if part.body in goals else role
        solids.append((part.shape, pose[:9].reshape(3, 3).T, pose[9:], role))
    return solids_seen(camera, solids)


def spatial_frames(
    machine: SpatialMachine, camera: PinholeCamera, state: np.ndarray, friction: float
) -> list[ContactFrame]:
    """Return the frame of every contact at ``state`` (q, v, ...), as seen by the camera."""
    rows = np.array(_frames(machine)(_of_unit_length(machine, state))).T
    return [frame_seen(camera, row[:3], row[3:], friction) for row in rows]


def _of_unit_length(machine: SpatialMachine, state: np.ndarray) -> np.ndarray:
    """Return q of ``state`` with quaternions of unit length, which interpolated states do not have."""
    tree = machine.tree()
    q, turning = np.array(state[: tree.nq], dtype=float), tree.quaternion_entries
    for four in (turning[k : k + 4] for k in range(0, len(turning), 4)):
        q[four] /= np.linalg.norm(q[four])
    return q


@cache
def _poses(machine: SpatialMachine) -> ca.Function:
    """Return the function from q to rotation and origin of every part's body, (12, parts)."""
    tree = machine.tree()
    q = ca.SX.sym("q", tree.nq)
    fixed = ca.SX.eye(3), ca.SX(3, 1)
    poses = (fixed if p.body == WORLD else tree.pose(q, p.body) for p in machine.parts)
    columns = [ca.vertcat(ca.vec(R), p) for R, p in poses]
    return ca.Function("poses", [q], [ca.densify(ca.horzcat(*columns))], {"cse": True})


@cache
def _frames(machine: SpatialMachine) -> ca.Function:
    """Return the function from q to the point and the normal of every contact, (6, contacts)."""
    tree = machine.tree()
    q = ca.SX.sym("q", tree.nq)
    columns = [ca.vertcat(contact.point, contact.normal) for contact in machine.contacts(q).values()]
    return ca.Function("frames", [q], [ca.densify(ca.horzcat(ca.SX(6, 0), *columns))])
