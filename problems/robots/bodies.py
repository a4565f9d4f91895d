"""Conversion of bodies, joints and motors of a compiled file to bodies in space, one body per joint."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dynamics.systems.space import WORLD, Body
from dynamics.systems.space.body import Joint
from problems.robots.inertias import Moments, combined

ROUNDED_TO_ZERO = 1e-12
"""Size of a vector's entry, relative to the size of the vector, below which the entry counts as zero."""
JOINTS: tuple[Joint, ...] = ("free", "ball", "slide", "hinge")
"""Kinds of joints, in the order of MuJoCo's numbers for them."""


@dataclass(frozen=True)
class BodyFrame:
    """A frame that is fixed to ``body``, with its origin at ``origin`` (3,) [m] and axes rotated by ``rotation``."""

    body: str
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    rotation: Rotation = field(default_factory=Rotation.identity)

    def compose(self, offset: np.ndarray, quaternion: np.ndarray) -> BodyFrame:
        """Return the frame whose origin ``offset`` [m] and ``quaternion`` (w, x, y, z) are relative to this frame."""
        orientation = self.rotation * Rotation.from_quat(quaternion, scalar_first=True)
        return BodyFrame(self.body, self.origin + self.rotation.apply(offset), orientation)


@dataclass(frozen=True)
class Actuator:
    """An actuator with the range of its input: a motor with ``gear``, or a servo with the stiffness ``servo``.

    ``damper`` is the name of the joint's velocity servo, whose input is 0 and which adds to ``damping``; "" if there is
    none.
    """

    name: str
    range: tuple[float, float]
    gear: float | None = None
    servo: float | None = None
    damping: float = 0.0
    damper: str = ""


def exact(values: Sequence[float] | np.ndarray, size: float = 1.0) -> Any:
    """Return ``values``, of magnitude ``size``, as a tuple; values that are 0 or ±1 up to rounding are exact."""
    without_zeros = (0.0 if abs(value) < ROUNDED_TO_ZERO * size else float(value) for value in values)
    return tuple(float(round(x)) if abs(abs(x) - 1) < ROUNDED_TO_ZERO else x for x in without_zeros)


def bodies(model: Any, actuators: Mapping[int, Actuator]) -> tuple[tuple[Body, ...], list[BodyFrame]]:
    """Return the robot's bodies, in the order of q, and for each body of the file its frame in one of the bodies.

    Bodies of the file without joints become part of their parent. A body with several joints becomes a
    chain of bodies, of which all but the last have no mass and the names of their joints. The frame of
    a body has its origin at its joint. Its axes are those of the file's body for a free or ball joint,
    and those of the parent at q = 0 for other joints.
    """
    poses, chain, last = [BodyFrame(WORLD)], list[Body](), dict[int, int]()
    names = {model.body(b).name for b in range(model.nbody)}
    for b in range(1, model.nbody):
        pose = poses[model.body_parentid[b]].compose(model.body_pos[b], model.body_quat[b])
        joints = np.flatnonzero(model.jnt_bodyid == b).tolist()
        for j in joints:
            name = model.body(b).name
            if j != joints[-1]:
                name = model.joint(j).name
                while name in names:
                    name += "'"
                names.add(name)
            body, pose = _jointed(model, j, name, pose, actuators.get(j))
            last[b] = len(chain)
            chain.append(body)
        poses.append(pose)
    for b, index in last.items():
        chain[index] = replace(chain[index], **_inertia(model, b, poses))
    return tuple(chain), poses


def _jointed(model: Any, j: int, name: str, pose: BodyFrame, actuator: Actuator | None) -> tuple[Body, BodyFrame]:
    """Return the body of joint ``j``, without mass, and the frame of the file's body relative to it.

    A hinge or slide has the parent's axes at q = 0, so that rotations by 90 degrees add no rounding errors.
    """
    kind, dof, index = JOINTS[model.jnt_type[j]], int(model.jnt_dofadr[j]), int(model.jnt_qposadr[j])
    damping = float(model.dof_damping[dof]) + (actuator.damping if actuator else 0.0)
    above = None if pose.body == WORLD else pose.body
    body = Body(name, above, 0.0, joint=kind, damping=damping)
    if kind == "free":
        return body, BodyFrame(name)
    anchor = pose.origin + pose.rotation.apply(model.jnt_pos[j])
    if kind == "ball":
        turn = exact(pose.rotation.as_quat(canonical=True, scalar_first=True))
        return replace(body, position=exact(anchor), quaternion=turn), BodyFrame(name, -model.jnt_pos[j])
    axis, q0 = pose.rotation.apply(model.jnt_axis[j]), float(model.qpos0[index])
    back, slid = Rotation.from_rotvec(-q0 * axis), 0.0
    if kind == "slide":
        back, slid = Rotation.identity(), q0 * axis
    low, high = model.jnt_range[j].tolist() if model.jnt_limited[j] else (-np.inf, np.inf)
    if np.isfinite(low) != np.isfinite(high):
        raise ValueError(f"joint {model.joint(j).name!r} has one infinite limit; give a number")
    body = replace(
        body,
        position=exact(anchor - slid),
        axis=exact(axis),
        armature=float(model.dof_armature[dof]),
        spring=float(model.jnt_stiffness[j]),
        rest=float(model.qpos_spring[index]) if model.jnt_stiffness[j] else 0.0,
        limits=(low, high) if np.isfinite(low) else None,
        gear=actuator and actuator.gear,
        servo=actuator and actuator.servo,
    )
    return body, BodyFrame(name, back.apply(pose.origin - anchor), back * pose.rotation)


def _inertia(model: Any, body: int, poses: Sequence[BodyFrame]) -> dict[str, Any]:
    """Return mass, inertia and centre of a body with all bodies welded to it, in its frame of :func:`bodies`."""
    solids = list[Moments]()
    for b in np.flatnonzero(model.body_weldid == body).tolist():
        frame = poses[b].compose(model.body_ipos[b], model.body_iquat[b])
        R = frame.rotation.as_matrix()
        solids.append((model.body_mass[b], frame.origin, R @ np.diag(model.body_inertia[b]) @ R.T))
    total, centre, inertia = combined(solids)
    six = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return {"mass": float(total), "inertia": exact(six, float(np.trace(inertia))), "com": exact(centre)}


def actuators_of(model: Any, followers: Container[int] = ()) -> dict[int, Actuator]:
    """Return a mapping from the number of a joint to its motor or servo.

    If a joint has a position servo and a velocity servo, the latter only adds damping. In a file without
    actuators, joints with bounded torque have motors, except ``followers``. Raises ``ValueError`` for a
    joint with any other pair of actuators.
    """
    actuators: dict[int, Actuator] = {}
    for k in range(model.nu):
        joint = int(model.actuator_trnid[k][0])
        if (actuator := actuator_of(model, k)) is None:
            continue
        if joint in actuators:
            servo, damper = sorted((actuators[joint], actuator), key=lambda d: d.servo is None)
            if servo.servo is None or damper.servo is not None or not damper.damping:
                name = model.joint(joint).name
                raise ValueError(
                    f"joint {name!r} has two motors, {actuators[joint].name} and {actuator.name}; give it one"
                )
            actuator = replace(servo, damping=servo.damping + damper.damping, damper=damper.name)
        actuators[joint] = actuator
    if model.nu == 0:
        for joint in np.flatnonzero(model.jnt_actfrclimited).tolist():
            torque = float(model.jnt_actfrcrange[joint][1])
            if torque > 0 and joint not in followers:
                actuators[joint] = Actuator(model.joint(joint).name, (-1.0, 1.0), gear=torque)
    return dict(sorted(actuators.items()))


def actuator_of(model: Any, k: int) -> Actuator | None:
    """Return actuator ``k`` of the file if it is a motor or a servo of a hinge or slide, else None."""
    joint, bias = int(model.actuator_trnid[k][0]), int(model.actuator_biastype[k])
    is_unsupported = model.actuator_gaintype[k] or model.actuator_dyntype[k] or bias > 1
    # Other transmissions refer to tendons, sites or bodies, not to joints.
    if is_unsupported or model.actuator_trntype[k] > 1 or JOINTS[model.jnt_type[joint]] in ("free", "ball"):
        return None
    gain, gear = float(model.actuator_gainprm[k][0]), float(model.actuator_gear[k][0])
    offset, stiff, damping = (-model.actuator_biasprm[k][:3] * bias).tolist()
    servo = stiff == gain > 0 and gear != 0
    if offset or (stiff and not servo):
        return None
    bounds = [(model.actuator_ctrllimited[k], model.actuator_ctrlrange[k], gear if servo else 1.0)]
    if not servo:
        force = model.actuator_forcelimited[k], model.actuator_forcerange[k], gain
        torque = model.jnt_actfrclimited[joint], model.jnt_actfrcrange[joint], gain * gear
        bounds += [force, torque]
    low, high = -np.inf, np.inf
    for limited, ends, unit in bounds:
        if limited and unit:
            a, b = sorted(float(end) / unit for end in ends)
            low, high = max(low, a), min(high, b)
    return Actuator(
        model.actuator(k).name,
        (low, high),
        gear=None if servo else gain * gear,
        servo=gain * gear**2 if servo else None,
        damping=damping * gear**2,
    )
