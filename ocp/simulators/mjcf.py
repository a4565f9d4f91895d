"""Machines written as MJCF, the language of MuJoCo, with numbers in place of symbols."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import cos, sin
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
from scipy.spatial.transform import Rotation

from dynamics.systems import WORLD, Link, Machine, contacts, space
from dynamics.systems.mechanism import Mechanism
from dynamics.systems.planar import root_first
from ocp.errors import InputError

GROUND = "z = 0"
_POINT = 1e-10
"""Radius [m] of a point, for MuJoCo has no sphere of radius zero."""
_Number = Callable[[Any], float]


class Mjcf(NamedTuple):
    """A machine's text, its joints in the order of our q, and the geoms of every contact."""

    text: str
    joints: list[str]
    pairs: dict[str, tuple[str, str]]


def mjcf(built: Mechanism, number: _Number, friction: Mapping[str, float]) -> Mjcf:
    """Write a machine whose contacts rub by ``friction``, by name; others are frictionless.

    ``number`` is what its entries are. Links of the plane turn about +y, as here; their discs are
    spheres, their boxes are deep, and a ``free`` one has two slides and a hinge. A body without
    mass that only carries another one is left out, and that one has the joints of both. Only what
    may touch here is a pair there, and parts that meet nothing are left out.

    Raises :class:`~ocp.errors.InputError` for a shape that MuJoCo has not, and for couplings, which
    it softens.
    """

    def row(value: Any) -> str:
        return " ".join(repr(number(v)) for v in (value if isinstance(value, tuple) else (value,)))

    def write(above: Element, tag: str, /, **given: Any) -> Element:
        """An element with words, numbers and rows of numbers, without what is None."""
        words = {
            key: value if isinstance(value, str) else row(value) for key, value in given.items() if value is not None
        }
        return SubElement(above, tag, words)

    machine = built.machine
    if getattr(machine, "couplings", ()):
        raise InputError("the machine has joints that follow others, which MuJoCo binds softly; try it here")
    flat = isinstance(machine, Machine)
    owners: tuple[Any, ...] = machine.links if flat else machine.bodies
    gravity = _deep(machine.chain().gravity if flat else machine.gravity)
    root = Element("mujoco")
    write(root, "compiler", angle="radian", inertiafromgeom="false")
    # MuJoCo 4.0.0 factorises sparse Jacobians wrongly.
    solver = {"cone": "elliptic", "integrator": "implicitfast", "jacobian": "dense"}
    write(write(root, "option", gravity=gravity, **solver), "flag", autoreset="disable")
    asset, bodies = write(root, "asset"), {WORLD: write(root, "worldbody")}
    contact, actuator = write(root, "contact"), write(root, "actuator")
    shapes, pairs = _shapes(built)
    parts = list(dict.fromkeys(part for pair in pairs.values() for part in pair))
    framed = {one.name: _planar(one, number) if flat else _spatial(one) for one in root_first(owners)}
    order = [move.name for one in owners for move in framed[one.name].moves]
    _merge(framed, {shapes[part][0] for part in parts}, number)
    one: Any
    for name, frame in framed.items():
        one = frame.owner
        body = write(bodies[frame.parent], "body", name=name, pos=frame.place, quat=frame.turn)
        bodies[name] = body
        for move in frame.moves:
            carrier: Any = move.owner
            given = {"range": carrier.limits, "damping": carrier.damping, "pos": move.at}
            if move.kind in ("hinge", "slide"):
                given |= {"axis": move.axis, "stiffness": carrier.spring}
                given |= {"armature": carrier.armature, "springref": getattr(carrier, "rest", None)}
            write(body, "joint", name=move.name, type=move.kind, **given)
        if number(one.mass):
            moments = (one.inertia,) * 3 if flat else one.inertia
            kind = "diaginertia" if len(moments) == 3 else "fullinertia"
            write(body, "inertial", mass=one.mass, pos=_deep(one.com), **{kind: moments})
    for one in root_first(owners):
        if one.gear is not None:
            gear = built.scale * one.gear
            write(actuator, "motor", name=one.name, joint=one.name, gear=gear)
        elif getattr(one, "servo", None) is not None:
            write(actuator, "position", name=one.name, joint=one.name, kp=one.servo)
    for part in parts:
        on, shape = shapes[part]
        if isinstance(shape, space.Hull):
            write(asset, "mesh", name=part, vertex=tuple(v for at in shape.points for v in at))
        given = _geom(part, on, shape, number)
        write(bodies[on], "geom", name=part, contype="0", conaffinity="0", mass="0", **given)
    for label, (geom1, geom2) in pairs.items():
        f = friction.get(label, friction.get(f"{label} 1", 0.0))
        rubs = (f, f, 0.005, 1e-4, 1e-4) if f else None
        write(contact, "pair", geom1=geom1, geom2=geom2, condim="3" if f else "1", friction=rubs)
    return Mjcf(tostring(root, encoding="unicode"), order, pairs)


class _Move(NamedTuple):
    """A joint of a link or body: its ``axis`` and a point ``at`` it in the own frame."""

    owner: Any
    name: str
    kind: str
    axis: Any
    at: Any = None


class _Frame(NamedTuple):
    """A link or body in MuJoCo: its place and turn in the parent's frame, and its joints."""

    owner: Any
    parent: str
    place: Any
    turn: Any
    moves: list[_Move]


def _spatial(body: space.Body) -> _Frame:
    moves = [] if body.joint == "fixed" else [_Move(body, body.name, body.joint, body.axis)]
    return _Frame(body, body.parent or WORLD, body.place, body.turn, moves)


def _planar(link: Link, number: _Number) -> _Frame:
    a, name = number(link.offset), link.name

    def along(x: Any, z: Any) -> tuple[Any, Any, Any]:
        """A direction of the parent's frame in the link's."""
        return x * cos(a) - z * sin(a), 0.0, x * sin(a) + z * cos(a)

    moves = [_Move(link, name, "hinge", (0.0, 1.0, 0.0))]
    if link.joint == "slide":
        moves = [_Move(link, name, "slide", along(*link.axis))]
    elif link.joint == "free":
        slides = [_Move(link, f"{name}_{end}", "slide", along(*axis)) for end, axis in (("x", (1, 0)), ("z", (0, 1)))]
        moves = [*slides, moves[0]._replace(name=f"{name}_angle")]
    turn = cos(a / 2), 0.0, sin(a / 2), 0.0
    return _Frame(link, link.parent or WORLD, _deep(link.anchor), turn, moves)


def _merge(frames: dict[str, _Frame], touching: set[str], number: _Number) -> None:
    """Give the joints of bodies without mass, that carry one other and touch nothing, to that one.

    MuJoCo moves no body without mass, but has several joints in one body, which act in turn.
    """

    def numbers(values: Any) -> np.ndarray:
        return np.array([number(value) for value in values])

    for name, upper in list(frames.items()):
        upper, one = frames[name], upper.owner
        carried = [child for child, frame in frames.items() if frame.parent == name]
        single = all(move.kind in ("hinge", "slide") for move in upper.moves)
        heavy = number(one.mass) or any(map(number, one.inertia))
        if heavy or len(carried) != 1 or name in touching or not single:
            continue
        lower = frames[carried[0]]
        place, quaternions = numbers(lower.place), [numbers(upper.turn), numbers(lower.turn)]
        above, turn = Rotation.from_quat(quaternions, scalar_first=True)
        moves = list[_Move]()
        for move in upper.moves:
            axis, at = numbers(move.axis), numbers(move.at or (0.0,) * 3) - place
            axis, at = (tuple(turn.inv().apply(vector)) for vector in (axis, at))
            moves.append(move._replace(axis=axis, at=at))
        frames[carried[0]] = lower._replace(
            parent=upper.parent,
            place=tuple(numbers(upper.place) + above.apply(place)),
            turn=tuple((above * turn).as_quat(scalar_first=True)),
            moves=[*moves, *lower.moves],
        )
        del frames[name]


def _deep(point: Any) -> tuple[Any, ...]:
    """A point of the plane, or in space, in space."""
    flat = not isinstance(point, tuple) or len(point) == 2
    return (point[0], 0.0, point[1]) if flat else point


def _shapes(built: Mechanism) -> tuple[dict[str, tuple[str, Any]], dict[str, tuple[str, str]]]:
    """Shapes by name, each with its body, and the pairs of every contact."""
    machine = built.machine
    pairs = {f"{one} on {other}": (one, other) for one, other in machine.meetings}
    if not isinstance(machine, Machine):
        return {part.name: (part.body, part.shape) for part in machine.parts}, pairs
    found = {part.name: (part.link, part.shape) for part in (*machine.spheres, *machine.parts)}
    down = [s.name for s in machine.spheres if built.spheres is None or s.name in built.spheres]
    return {GROUND: (WORLD, space.Plane()), **found}, {n: (n, GROUND) for n in down} | pairs


def _geom(part: str, on: str, shape: Any, number: _Number) -> dict[str, Any]:
    """A shape of the plane or in space as attributes of a geom."""
    match shape:
        case space.Sphere() | contacts.Disc():
            radius = max(number(shape.radius), _POINT)
            return {"type": "sphere", "size": radius, "pos": _deep(shape.centre)}
        case space.Capsule() | space.Cylinder() | contacts.Capsule():
            ends = (*_deep(shape.start), *_deep(shape.end))
            return {"type": type(shape).__name__.lower(), "size": shape.radius, "fromto": ends}
        case space.Box():
            placed = {"pos": shape.centre, "quat": shape.turn}
            return {"type": "box", "size": shape.half_size, **placed}
        case contacts.Box() if shape.radius == 0:
            x, z = shape.half_size[0], shape.half_size[1]
            return {"type": "box", "size": (x, x + z, z), "pos": _deep(shape.centre)}
        case space.Hull():
            return {"type": "mesh", "mesh": part}
        case space.Plane() | contacts.HalfPlane() if on == WORLD:
            placed = {"pos": _deep(shape.origin), "zaxis": _deep(shape.normal)}
            return {"type": "plane", "size": "0 0 1", **placed}
    what = "rounded" if isinstance(shape, contacts.Box) else "moving"
    raise InputError(f"part {part!r} is a {what} {type(shape).__name__}, which MuJoCo has not")
