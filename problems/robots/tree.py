"""Bodies and joints of a compiled file as links of the plane, and its motors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dynamics.systems import Link

TILT = 1e-5
"""How far an axis may be off the plane, as rounded angles are; the mass matrix sees its square."""
_ROUNDING = 1e-12
_SLIDE, _HINGE = 2, 3
Plane = np.ndarray
"""A point or vector (x, z)."""


def joint_name(model: Any, joint: int) -> str:
    """The name of a joint, or its number where it has none."""
    return model.joint(joint).name or f"joint {joint + 1}"


def body_name(model: Any, body: int) -> str:
    """The name of a body, or its number where it has none."""
    return model.body(body).name or f"body {body}"


def clean(vector: Sequence[float] | np.ndarray) -> tuple[float, float]:
    """Two numbers without what rounding leaves of zeros."""
    x, z = (0.0 if abs(value) < _ROUNDING else float(value) for value in vector)
    return x, z


def plane(vector: np.ndarray) -> Plane:
    """The part (x, z) of a vector in space."""
    return np.array([vector[0], vector[2]])


@dataclass(frozen=True)
class Frame:
    """A link's frame at the file's reference: its ``origin`` (x, z) [m] and ``angle`` [rad]."""

    link: str
    origin: Plane
    angle: float

    def turned_back(self, vector: Plane) -> Plane:
        """A vector (x, z) of the world in this frame."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])

    def local(self, point: Plane) -> Plane:
        """A point (x, z) of the world in this frame [m]."""
        return self.turned_back(point - self.origin)


@dataclass(frozen=True)
class Motor:
    """A motor's name, its force or torque along q for a unit of input, and the input's range."""

    name: str
    gear: float
    range: tuple[float, float]


@dataclass(frozen=True)
class Coordinate:
    """A coordinate's joint in the file, its sign, where its spring rests, and its motor.

    ``q0`` is q where the joint is at its reference.
    """

    joint: int
    sign: float
    rest: float
    q0: float
    motor: Motor | None


def tree(model: Any, data: Any) -> tuple[list[Link], dict[int, Frame], list[Coordinate]]:
    """Links, the frames of bodies that carry one, with the world's at 0, and the coordinates.

    Raises ``ValueError`` for a body with joints that one link cannot have.
    """
    frames = {0: Frame("world", np.zeros(2), 0.0)}
    links: list[Link] = []
    coordinates: list[Coordinate] = []
    motors = motors_of(model)
    for body in (b for b in range(1, model.nbody) if model.body_weldid[b] == b):
        above = int(model.body_weldid[model.body_parentid[body]])
        joints = _joints(model, data, body, above)
        own = [_coordinate(model, data, j, motors.get(j), len(joints) == 3) for j in joints]
        link, frames[body] = _link(model, data, body, frames[above], own)
        links.append(link)
        coordinates += own
    return links, frames, coordinates


def _joints(model: Any, data: Any, body: int, above: int) -> list[int]:
    """The joint of a body, or those of a root along x, along z and about y, in this order."""
    first = int(model.body_jntadr[body])
    joints = list(range(first, first + int(model.body_jntnum[body])))
    if len(joints) == 1:
        return joints
    kinds = [int(kind) for kind in model.jnt_type[joints]]
    if above == 0 and kinds == [_SLIDE, _SLIDE, _HINGE]:
        across = sorted(joints[:2], key=lambda j: abs(data.xaxis[j][2]))
        straight = [
            abs(data.xaxis[j][k]) > 1 - TILT**2 for j, k in zip(across, (0, 2), strict=True)
        ]
        if all(straight):
            return [*across, joints[2]]
    raise ValueError(
        f"body {body_name(model, body)!r} has the joints"
        f" {', '.join(joint_name(model, j) for j in joints)}; a body has one, or at the root a"
        " slide along x, one along z and then a hinge about y"
    )


def _coordinate(model: Any, data: Any, joint: int, motor: Motor | None, root: bool) -> Coordinate:
    axis, slides = data.xaxis[joint], model.jnt_type[joint] == _SLIDE
    along = axis[1] if not slides else axis[0] + axis[2] if root else 1.0
    sign, at = float(np.sign(along)), model.jnt_qposadr[joint]
    rest = float(model.qpos_spring[at]) if model.jnt_stiffness[joint] else 0.0
    if motor is not None:
        motor = replace(motor, gear=sign * motor.gear)
    return Coordinate(joint, sign, rest, sign * (float(model.qpos0[at]) - rest), motor)


def _link(
    model: Any, data: Any, body: int, parent: Frame, own: list[Coordinate]
) -> tuple[Link, Frame]:
    """The link of a body and of all that is fixed to it, with its frame."""
    name, last = body_name(model, body), own[-1]
    hinge = model.jnt_type[last.joint] == _HINGE
    R = data.xmat[body].reshape(3, 3)
    angle = float(np.arctan2(R[0, 2], R[0, 0])) if R[1, 1] > 1 - TILT**2 else 0.0
    frame = Frame(name, plane(data.xanchor[last.joint] if hinge else data.xpos[body]), angle)
    anchor, axis = parent.local(frame.origin), parent.turned_back(plane(data.xaxis[last.joint]))
    if len(own) == 3:
        anchor = anchor - [own[0].q0, own[1].q0]
    elif not hinge:
        anchor = anchor - axis * own[0].q0
    mass, inertia, com = _inertia(model, data, body)
    (offset, _) = clean([angle - parent.angle - last.q0 * hinge, 0.0])
    motor = _alike(model, own, "motors", [one.motor for one in own])
    limits = _alike(model, own, "limits", [_limits(model, one) for one in own])
    joints = [one.joint for one in own]
    dofs = [int(model.jnt_dofadr[j]) for j in joints]
    link = Link(
        name,
        None if parent.link == "world" else parent.link,
        mass,
        inertia,
        com=clean(frame.local(com)),
        anchor=clean(anchor),
        offset=offset,
        joint="free" if len(own) == 3 else "hinge" if hinge else "slide",
        axis=(1.0, 0.0) if hinge else clean(axis / np.hypot(*axis)),
        spring=_alike(model, own, "springs", model.jnt_stiffness[joints].tolist()),
        damping=_alike(model, own, "dampings", model.dof_damping[dofs].tolist()),
        gear=None if motor is None else motor.gear,
        limits=limits,
        armature=_alike(model, own, "armatures", model.dof_armature[dofs].tolist()),
    )
    return link, frame


def _alike(model: Any, own: list[Coordinate], what: str, values: list[Any]) -> Any:
    """What all coordinates of a link have in common; raises ``ValueError`` where they differ."""
    if any(value != values[0] for value in values):
        names = ", ".join(joint_name(model, one.joint) for one in own)
        raise ValueError(
            f"the joints {names} float as one and have different {what}; give all three the same,"
            " best none"
        )
    return values[0]


def _limits(model: Any, one: Coordinate) -> tuple[float, float] | None:
    if not model.jnt_limited[one.joint]:
        return None
    low, high = sorted(
        one.sign * (float(end) - one.rest) + 0.0 for end in model.jnt_range[one.joint]
    )
    return low, high


def _inertia(model: Any, data: Any, body: int) -> tuple[float, float, Plane]:
    """Mass [kg], inertia about +y [kg m²] and centre of mass (x, z) [m] of all that is welded."""
    parts = [b for b in range(model.nbody) if model.body_weldid[b] == body]
    masses = model.body_mass[parts]
    centres = data.xipos[parts][:, [0, 2]]
    total = float(masses.sum())
    centre = masses @ centres / total if total > 0 else centres[0]
    turned = data.ximat[parts].reshape(-1, 3, 3)[:, 1, :] ** 2
    own = (turned * model.body_inertia[parts]).sum(axis=1)
    return total, float(own.sum() + masses @ ((centres - centre) ** 2).sum(axis=1)), centre


def is_motor(model: Any, k: int) -> bool:
    """Whether an actuator is a motor of a hinge or slide: its force is the input times a number."""
    kinds = (model.actuator_gaintype, model.actuator_biastype, model.actuator_dyntype)
    plain = int(model.actuator_trntype[k]) in (0, 1) and not any(int(kind[k]) for kind in kinds)
    return plain and int(model.jnt_type[model.actuator_trnid[k][0]]) in (_SLIDE, _HINGE)


def motors_of(model: Any) -> dict[int, Motor]:
    """Motors by joint; of a file without any those of joints whose torque is bounded."""
    found: dict[int, Motor] = {}
    for k in (k for k in range(model.nu) if is_motor(model, k)):
        joint = int(model.actuator_trnid[k][0])
        if joint in found:
            raise ValueError(f"joint {joint_name(model, joint)!r} has two motors; give it one")
        gain, gear = float(model.actuator_gainprm[k][0]), float(model.actuator_gear[k][0])
        low, high = -np.inf, np.inf
        for limited, bounds, unit in (
            (model.actuator_ctrllimited[k], model.actuator_ctrlrange[k], 1.0),
            (model.actuator_forcelimited[k], model.actuator_forcerange[k], gain),
            (model.jnt_actfrclimited[joint], model.jnt_actfrcrange[joint], gain * gear),
        ):
            if limited and unit:
                a, b = sorted(float(bound) / unit for bound in bounds)
                low, high = max(low, a), min(high, b)
        name = model.actuator(k).name or joint_name(model, joint)
        found[joint] = Motor(name, gain * gear, (low, high))
    if model.nu == 0:
        for joint in np.flatnonzero(model.jnt_actfrclimited).tolist():
            most = float(model.jnt_actfrcrange[joint][1])
            if most > 0:
                found[joint] = Motor(joint_name(model, joint), most, (-1.0, 1.0))
    return found
