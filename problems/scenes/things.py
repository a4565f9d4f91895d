"""What stands in a scene: bodies, pushers, obstacles and goals, and where they may touch."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from itertools import combinations

import casadi as ca

from dynamics.systems import Signal
from dynamics.systems.contacts import Contact, Disc, Pose, Shape
from dynamics.systems.contacts.shapes import Point, Scalar, column

_AXES = ("x", "y")


@dataclass(frozen=True, eq=False)
class Thing:
    """A ``shape`` called ``name``, at ``at`` [m], turned anticlockwise by ``angle`` [rad].

    The shape lies in the thing's own frame, whose origin is at ``at``.
    """

    name: str
    shape: Shape
    at: Point
    angle: Scalar = 0.0

    @property
    def coordinates(self) -> tuple[Signal, ...]:
        """How it moves; nothing moves an obstacle."""
        return ()

    @property
    def turns(self) -> bool:
        """Whether its angle may change."""
        return False

    @property
    def start(self) -> ca.SX:
        """The coordinates where it starts."""
        return ca.SX(0, 1)

    def pose(self, q: ca.SX) -> Pose:
        """Where it is at its own coordinates ``q``."""
        return Pose(column(self.at), -ca.SX(self.angle))


class Obstacle(Thing):
    """What never moves."""


@dataclass(frozen=True, eq=False)
class Body(Thing):
    """What moves freely, with coordinates x, y [m], and an angle [rad] where it has an ``inertia``.

    ``mass`` [kg]; ``inertia`` [kg m²] about the origin of its frame, which is its centre of mass,
    None for a body that never turns.
    """

    mass: Scalar = 1.0
    inertia: Scalar | None = None

    @property
    def coordinates(self) -> tuple[Signal, ...]:
        """``<name>_x``, ``<name>_y`` and, where it turns, ``<name>_angle``."""
        found = _places(self.name)
        turn = Signal(f"{self.name}_angle", "rad", f"{self.name}, anticlockwise")
        return (*found, turn) if self.turns else found

    @property
    def turns(self) -> bool:
        """Whether it has an inertia."""
        return self.inertia is not None

    @property
    def start(self) -> ca.SX:
        """``at`` and, where it turns, ``angle``."""
        return ca.vertcat(column(self.at), self.angle) if self.turns else column(self.at)

    def pose(self, q: ca.SX) -> Pose:
        """Where it is at its own coordinates ``q``."""
        return Pose(q[:2], -ca.SX(q[2] if self.turns else self.angle))


@dataclass(frozen=True, eq=False)
class Pusher(Thing):
    """What a motor moves; it never turns.

    In a quasi-dynamic scene a spring of ``stiffness`` [N/m] draws it to the commanded place, in one
    with velocities it has a ``mass`` [kg] and is pushed by a force. It moves in the plane, or on a
    rail along the unit vector ``axis``, with the way gone from ``at`` [m] as its one coordinate.
    """

    stiffness: Scalar | None = None
    mass: Scalar | None = None
    axis: Point | None = None

    @property
    def coordinates(self) -> tuple[Signal, ...]:
        """``<name>_x`` and ``<name>_y``, or the way gone ``<name>``."""
        if self.axis is None:
            return _places(self.name)
        return (Signal(self.name, "m", f"way of {self.name} along its rail"),)

    @property
    def start(self) -> ca.SX:
        """``at``, or no way gone."""
        return column(self.at) if self.axis is None else ca.SX.zeros(1)

    def pose(self, q: ca.SX) -> Pose:
        """Where it is at its own coordinates ``q``."""
        place = q if self.axis is None else column(self.at) + q * column(self.axis)
        return Pose(place, -ca.SX(self.angle))

    @property
    def directions(self) -> ca.SX:
        """Unit vectors in which its coordinates move it, as columns."""
        return ca.SX.eye(2) if self.axis is None else column(self.axis)


@dataclass(frozen=True, eq=False)
class Goal:
    """Where the body called ``body`` should come to, drawn in its shape; nothing touches it."""

    body: str
    at: Point
    angle: Scalar = 0.0


def _places(name: str) -> tuple[Signal, ...]:
    return tuple(Signal(f"{name}_{axis}", "m", name) for axis in _AXES)


PoseOf = Callable[[Thing], Pose]
_FIRST = (Body, Pusher, Obstacle)


@dataclass(frozen=True, eq=False)
class Touch:
    """A contact called ``name``: ``shape`` of one thing on a shape of another.

    Its normal points into the ``one``, which is the one that moves more freely.
    """

    name: str
    one: Thing
    shape: Shape
    other: Thing
    against: Shape

    def contact(self, pose: PoseOf) -> Contact:
        """Gap, normal and point with every thing where ``pose`` has it."""
        return Contact.between(self.shape, pose(self.one), self.against, pose(self.other))

    @property
    def pair(self) -> frozenset[str]:
        """Names of both."""
        return frozenset((self.one.name, self.other.name))


def touches(things: Sequence[Thing], apart: Collection[frozenset[str]]) -> list[Touch]:
    """All contacts of two things of which one moves, but of the pairs in ``apart``.

    Where flat sides may come to lie on each other at any angle, every corner is a contact of its
    own, ``<one> on <other> <number>``: what rests on a side rests on its two ends, and the nearest
    corner alone would have no gradient where two are equally near.
    """
    found = []
    for first, second in combinations(things, 2):
        still = isinstance(first, Obstacle) and isinstance(second, Obstacle)
        if still or frozenset((first.name, second.name)) in apart:
            continue
        called = f"{first.name} on {second.name}"
        one, other = sorted((first, second), key=_rank)
        pairs = _shapes(one, other)
        names = [called] if len(pairs) == 1 else [f"{called} {i + 1}" for i in range(len(pairs))]
        found += [
            Touch(name, one, shape, other, against)
            for name, (shape, against) in zip(names, pairs, strict=True)
        ]
    return found


def _rank(thing: Thing) -> int:
    return next(i for i, kind in enumerate(_FIRST) if isinstance(thing, kind))


def _shapes(one: Thing, other: Thing) -> list[tuple[Shape, Shape]]:
    a, b = one.shape, other.shape
    round_one = any(len(shape.corners) == 1 for shape in (a, b))
    if round_one or not (one.turns or other.turns):
        return [(a, b)]
    return [*((disc, b) for disc in _corners(a)), *((a, disc) for disc in _corners(b))]


def _corners(shape: Shape) -> list[Disc]:
    return [Disc(shape.radius, corner) for corner in shape.corners]
