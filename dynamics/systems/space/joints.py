"""Frames of bodies in space at the positions of their joints."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from dynamics.systems.space import rotation
from dynamics.systems.space.body import Body


@dataclass(frozen=True, eq=False)
class JointFrame:
    """Rotation of a body's axes into its parent's axes, origin in the parent's frame [m], and motions of the joint.

    ``turns`` and ``moves`` (3, n) are the columns of angular and linear velocity in the body's axes for each
    entry of v; linear velocities of a free joint are omitted, see :class:`~dynamics.systems.space.tree.Tree`.
    """

    R: ca.SX
    r: ca.SX
    turns: ca.SX
    moves: ca.SX


def joint_frame(body: Body, at: ca.SX) -> JointFrame:
    """Return the frame of a body; ``at`` are the body's entries of q."""
    axis = ca.sparsify(ca.SX(ca.vertcat(*body.axis)))
    orientation, none = rotation.matrix(ca.SX(ca.vertcat(*body.quaternion))), ca.SX(3, 1)
    position = ca.sparsify(ca.SX(ca.vertcat(*body.position)))
    match body.joint:
        case "hinge":
            return JointFrame(ca.sparsify(orientation) @ rotation.from_axis_angle(axis, at), position, axis, none)
        case "slide":
            orientation = ca.sparsify(orientation)
            return JointFrame(orientation, position + orientation @ axis * at, none, axis)
        case "ball":
            R = ca.sparsify(orientation) @ rotation.matrix(at)
            return JointFrame(R, position, ca.SX.eye(3), ca.SX(3, 3))
        case "free":
            return JointFrame(rotation.matrix(at[3:]), at[:3], ca.SX.eye(3), ca.SX(3, 3))
    return JointFrame(ca.sparsify(orientation), position, ca.SX(3, 0), ca.SX(3, 0))
