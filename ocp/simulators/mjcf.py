"""Conversion of machines to MJCF, the XML format of MuJoCo, with numbers in place of symbols."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import cos, sin, sqrt
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, SubElement, tostring

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

from dynamics.systems import WORLD, Link, space
from dynamics.systems import shapes as planar_shapes
from dynamics.systems.mechanism import Mechanism, PlacedShape
from dynamics.systems.planar.links import root_first
from ocp.errors import InputError

GROUND = "z = 0"
"""Name of the ground's geom."""
SERVO_RADIUS_M = 0.01
"""Radius of gyration [m] of a servo's mass, which slides do not rotate."""
MIN_RADIUS_M = 1e-10
"""Radius of a sphere that represents a point [m], since MuJoCo does not allow a zero radius."""
_Number = Callable[[Any], float]
"""Function from a parameter or expression to its value."""


class Mjcf(NamedTuple):
    """MJCF text of a machine, its joints in the order of q, and the two geoms of every contact.

    ``servo_masses`` maps slides to the mass [kg] of their servos, which the machine does not have.
    """

    text: str
    joints: list[str]
    pairs: dict[str, tuple[str, str]]
    servo_masses: dict[str, float]


def write_mjcf(mechanism: Mechanism, number: _Number, friction: Mapping[str, float], servo_time: float) -> Mjcf:
    """Return a machine as MJCF; ``friction`` maps contacts to coefficients, and other contacts are frictionless.

    ``number`` evaluates the machine's entries. Links of the plane rotate about +y, as in the machine;
    their discs become spheres, their boxes get a depth, and a ``free`` link has two slides and a hinge.
    A massless body with a single child is merged into the child, which then has the joints of both. A massless
    body on slides with servos of stiffness K gets their mass, the least ``K servo_time^2``, which has no weight, and
    its servos are damped critically.
    Only pairs that may touch in the machine collide; parts that occur in no pair are left out.

    Raises :class:`~ocp.errors.InputError` for a shape that MuJoCo lacks, and for couplings, which
    MuJoCo softens.
    """
    machine, write = mechanism.machine, _Writer(number)
    if getattr(machine, "couplings", ()):
        raise InputError("the machine has joints that follow others, which MuJoCo binds softly; try it here")
    root = Element("mujoco")
    write(root, "compiler", angle="radian", inertiafromgeom="false")
    # MuJoCo 4.0.0 factorises sparse Jacobians wrongly.
    solver = {"cone": "elliptic", "integrator": "implicitfast", "jacobian": "dense"}
    write(write(root, "option", gravity=_to_space(machine.tree().gravity), **solver), "flag", autoreset="disable")
    asset, bodies = write(root, "asset"), {WORLD: write(root, "worldbody")}
    contact, actuator = write(root, "contact"), write(root, "actuator")
    shapes, pairs = _shapes(mechanism)
    part_names = list(dict.fromkeys(part_name for pair in pairs.values() for part_name in pair))
    members = root_first(machine.members)
    frames = {member.name: _body_frame(member, number) for member in members}
    order = [joint.name for member in machine.members for joint in frames[member.name].moves]
    _merge_massless(frames, {shapes[part_name].owner for part_name in part_names}, number)
    servo_masses = _add_servo_masses(frames, number, servo_time)
    for name, frame in frames.items():
        bodies[name] = write.body(bodies[frame.parent], name, frame)
    for member in members:
        if member.gear is not None:
            write(actuator, "motor", name=member.name, joint=member.name, gear=mechanism.scale * member.gear)
        elif getattr(member, "servo", None) is not None:
            write(actuator, "position", name=member.name, joint=member.name, kp=member.servo)
    for part_name in part_names:
        placed = shapes[part_name]
        if isinstance(placed.shape, space.Hull):
            write(asset, "mesh", name=part_name, vertex=tuple(v for point in placed.shape.points for v in point))
        attributes = _geom(placed, number)
        write(bodies[placed.owner], "geom", name=part_name, contype="0", conaffinity="0", mass="0", **attributes)
    for label, (geom1, geom2) in pairs.items():
        f = friction.get(label, friction.get(f"{label} 1", 0.0))
        pair_friction = (f, f, 0.005, 1e-4, 1e-4) if f else None
        write(contact, "pair", geom1=geom1, geom2=geom2, condim="3" if f else "1", friction=pair_friction)
    return Mjcf(tostring(root, encoding="unicode"), order, pairs, servo_masses)


@dataclass(frozen=True)
class _Writer:
    """Writer of XML elements; ``number`` evaluates their entries."""

    number: _Number

    def __call__(self, parent: Element, tag: str, /, **attributes: Any) -> Element:
        """Append and return an element with texts, numbers and rows of numbers; attributes that are None are unset."""
        present = {key: value for key, value in attributes.items() if value is not None}
        return SubElement(parent, tag, {key: v if isinstance(v, str) else self._row(v) for key, v in present.items()})

    def _row(self, value: Any) -> str:
        return " ".join(repr(self.number(v)) for v in (value if isinstance(value, tuple) else (value,)))

    def body(self, parent: Element, name: str, frame: _BodyFrame) -> Element:
        """Append and return a body with its joints and its inertia."""
        owner = frame.owner
        body = self(parent, "body", name=name, pos=frame.position, quat=frame.quaternion)
        for joint in frame.moves:
            carrier: Any = joint.owner
            attributes = {"range": carrier.limits, "damping": carrier.damping, "pos": joint.point}
            if joint.kind in ("hinge", "slide"):
                attributes |= {"axis": joint.axis, "stiffness": carrier.spring}
                attributes |= {"armature": carrier.armature, "springref": getattr(carrier, "rest", None)}
                attributes |= {"damping": joint.servo_damping or carrier.damping}
            self(body, "joint", name=joint.name, type=joint.kind, **attributes)
        if frame.servo_mass:
            body.set("gravcomp", "1")
            moments = (frame.servo_mass * SERVO_RADIUS_M**2,) * 3
            self(body, "inertial", mass=frame.servo_mass, pos=(0.0,) * 3, diaginertia=moments)
        elif self.number(owner.mass):
            moments = (owner.inertia,) * 3 if isinstance(owner, Link) else owner.inertia
            kind = "diaginertia" if len(moments) == 3 else "fullinertia"
            self(body, "inertial", mass=owner.mass, pos=_to_space(owner.com), **{kind: moments})
        return body


class _Joint(NamedTuple):
    """A joint of a link or body: its ``axis``, and a ``point`` on the axis, in the owner's frame.

    ``servo_damping`` [N s/m] is that of a servo that moves nothing but its own mass.
    """

    owner: Any
    name: str
    kind: str
    axis: Any
    point: Any = None
    servo_damping: float | None = None


class _BodyFrame(NamedTuple):
    """A link or body in MuJoCo: its pose in the parent's frame and its joints."""

    owner: Any
    parent: str
    position: Any
    quaternion: Any
    moves: list[_Joint]
    servo_mass: float = 0.0


def _body_frame(body: Link | space.Body, number: _Number) -> _BodyFrame:
    if isinstance(body, Link):
        return _link_frame(body, number)
    moves = [] if body.joint == "fixed" else [_Joint(body, body.name, body.joint, body.axis)]
    return _BodyFrame(body, body.parent or WORLD, body.position, body.quaternion, moves)


def _link_frame(link: Link, number: _Number) -> _BodyFrame:
    a, name = number(link.offset), link.name

    def in_link_frame(x: Any, z: Any) -> tuple[Any, Any, Any]:
        """Convert a direction from the parent's frame to the link's frame."""
        return x * cos(a) - z * sin(a), 0.0, x * sin(a) + z * cos(a)

    moves = [_Joint(link, name, "hinge", (0.0, 1.0, 0.0))]
    if link.joint == "slide":
        moves = [_Joint(link, name, "slide", in_link_frame(*link.axis))]
    elif link.joint == "free":
        slides = [
            _Joint(link, f"{name}_{end}", "slide", in_link_frame(*axis)) for end, axis in (("x", (1, 0)), ("z", (0, 1)))
        ]
        moves = [*slides, moves[0]._replace(name=f"{name}_angle")]
    quaternion = cos(a / 2), 0.0, sin(a / 2), 0.0
    return _BodyFrame(link, link.parent or WORLD, _to_space(link.anchor), quaternion, moves)


def _merge_massless(frames: dict[str, _BodyFrame], touching_names: set[str], number: _Number) -> None:
    """Merge massless bodies with a single child, which touch nothing, into this child.

    MuJoCo does not allow a moving body without mass, but allows several joints in one body, which act in sequence.
    """

    def numbers(values: Any) -> np.ndarray:
        return np.array([number(value) for value in values])

    for name, upper in list(frames.items()):
        upper, owner = frames[name], upper.owner
        children = [child for child, frame in frames.items() if frame.parent == name]
        has_simple_joints = all(joint.kind in ("hinge", "slide") for joint in upper.moves)
        heavy = number(owner.mass) or any(map(number, owner.inertia))
        if heavy or len(children) != 1 or name in touching_names or not has_simple_joints:
            continue
        lower = frames[children[0]]
        offset, quaternions = numbers(lower.position), [numbers(upper.quaternion), numbers(lower.quaternion)]
        upper_rotation, lower_rotation = Rotation.from_quat(quaternions, scalar_first=True)
        joints = list[_Joint]()
        for joint in upper.moves:
            axis, point = numbers(joint.axis), numbers(joint.point or (0.0,) * 3) - offset
            axis, point = (tuple(lower_rotation.inv().apply(vector)) for vector in (axis, point))
            joints.append(joint._replace(axis=axis, point=point))
        frames[children[0]] = lower._replace(
            parent=upper.parent,
            position=tuple(numbers(upper.position) + upper_rotation.apply(offset)),
            quaternion=tuple((upper_rotation * lower_rotation).as_quat(scalar_first=True)),
            moves=[*joints, *lower.moves],
        )
        del frames[name]


def _add_servo_masses(frames: dict[str, _BodyFrame], number: _Number, servo_time: float) -> dict[str, float]:
    """Give mass and critical damping to massless bodies on slides with servos, and return the mass of each slide."""
    servo_masses, parents = dict[str, float](), {frame.parent for frame in frames.values()}
    for name, frame in frames.items():
        servos = [getattr(joint.owner, "servo", None) for joint in frame.moves if joint.kind == "slide"]
        stiffnesses = [number(servo) for servo in servos if servo is not None]
        if name in parents or number(frame.owner.mass) or not 0 < len(frame.moves) == len(stiffnesses):
            continue
        mass = min(stiffnesses) * servo_time**2
        dampings = [2 * sqrt(K * mass) for K in stiffnesses]
        moves = [joint._replace(servo_damping=d) for joint, d in zip(frame.moves, dampings, strict=True)]
        frames[name] = frame._replace(moves=moves, servo_mass=mass)
        servo_masses |= {joint.name: mass for joint in moves}
    return servo_masses


def _to_space(point: Any) -> tuple[Any, ...]:
    """Return a point of the plane or of space as a point of space."""
    entries = point if isinstance(point, tuple) else tuple(ca.SX(point).elements())
    return (entries[0], 0.0, entries[1]) if len(entries) == 2 else entries


def _shapes(mechanism: Mechanism) -> tuple[dict[str, PlacedShape], dict[str, tuple[str, str]]]:
    """Return a dict from names to shapes, including the ground, and a dict from contacts to pairs of names."""
    machine = mechanism.machine
    spheres = [sphere.name for sphere in getattr(machine, "spheres", ())]
    on_ground = [name for name in spheres if mechanism.spheres is None or name in mechanism.spheres]
    shapes = [PlacedShape(GROUND, WORLD, space.Plane()), *machine.shapes]
    pairs = {f"{first} on {second}": (first, second) for first, second in machine.collision_pairs}
    return {placed.name: placed for placed in shapes}, {name: (name, GROUND) for name in on_ground} | pairs


def _geom(placed: PlacedShape, number: _Number) -> dict[str, Any]:
    """Return the attributes of a shape's geom."""
    part_name, shape = placed.name, placed.shape
    match shape:
        case space.Sphere() | planar_shapes.Disc():
            radius = max(number(shape.radius), MIN_RADIUS_M)
            return {"type": "sphere", "size": radius, "pos": _to_space(shape.centre)}
        case space.Capsule() | space.Cylinder() | planar_shapes.Capsule():
            ends = (*_to_space(shape.start), *_to_space(shape.end))
            return {"type": type(shape).__name__.lower(), "size": shape.radius, "fromto": ends}
        case space.Box():
            pose = {"pos": shape.centre, "quat": shape.quaternion}
            return {"type": "box", "size": shape.half_size, **pose}
        case planar_shapes.Box() if shape.radius == 0:
            x, z = shape.half_size[0], shape.half_size[1]
            return {"type": "box", "size": (x, x + z, z), "pos": _to_space(shape.centre)}
        case space.Hull():
            return {"type": "mesh", "mesh": part_name}
        case space.Plane() | planar_shapes.HalfPlane() if placed.owner == WORLD:
            pose = {"pos": _to_space(shape.origin), "zaxis": _to_space(shape.normal)}
            return {"type": "plane", "size": "0 0 1", **pose}
    kind = "rounded" if isinstance(shape, planar_shapes.Box) else "moving"
    raise InputError(f"part {part_name!r} is a {kind} {type(shape).__name__}, which MuJoCo does not support")
