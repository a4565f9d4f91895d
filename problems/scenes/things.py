"""Bodies, pushers, obstacles and goals of a scene, and the pairs that may touch."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from itertools import combinations

import casadi as ca

from dynamics.systems import Signal
from dynamics.systems.checks import parse_number, parse_point, require_positive, require_text, require_unit_vector
from dynamics.systems.limit_surface import LimitSurface
from dynamics.systems.shapes import Contact, Pose, Shape, Union
from dynamics.systems.shapes.areas import mean_distance, move_shape, shape_area
from dynamics.systems.shapes.planar import Point, Scalar, as_column
from dynamics.systems.shapes.polygon import convex_parts, vertex_pairs


@dataclass(frozen=True, eq=False)
class Thing:
    """Element of a scene: a ``shape`` called ``name``, at ``at`` [m], rotated anticlockwise by ``angle`` [rad].

    The shape is in the element's frame, whose origin is at ``at``. Raises ``ValueError`` for an
    invalid argument.
    """

    name: str
    shape: Shape | Union
    at: Point
    angle: Scalar = 0.0

    def __post_init__(self) -> None:
        require_text(f"the name of the {type(self).__name__}", self.name)
        if not isinstance(self.shape, Shape | Union):
            raise ValueError(
                f"{self.name}: shape must be a Disc, Box, Capsule, Polygon, HalfPlane or Union of"
                f" problems.scenes, got {self.shape!r}"
            )
        parse_point(f"{self.name}: at", self.at)
        parse_number(f"{self.name}: angle", self.angle)
        for field in ("mass", "inertia", "stiffness", "table", "reach"):
            if (value := getattr(self, field, None)) is not None:
                require_positive(f"{self.name}: {field}", value)
        if (axis := getattr(self, "axis", None)) is not None:
            require_unit_vector(f"{self.name}: axis", parse_point(f"{self.name}: axis", axis))

    @property
    def coordinates(self) -> tuple[Signal, ...]:
        """Signals of the coordinates; empty for an obstacle."""
        return ()

    @property
    def turns(self) -> bool:
        """Whether the angle can change."""
        return False

    @property
    def start(self) -> ca.SX:
        """Coordinates at the start, (n, 1); empty for an obstacle."""
        return ca.SX(0, 1)

    def pose(self, q: ca.SX) -> Pose:
        """Return the pose at the coordinates ``q`` (n, 1)."""
        return Pose(as_column(self.at), -ca.SX(self.angle))


class Obstacle(Thing):
    """Obstacle: an element of a scene that never moves."""


@dataclass(frozen=True, eq=False)
class Body(Thing):
    """Body: an element of a scene that moves freely, by x, y [m] and, if it has an ``inertia``, an angle [rad].

    ``mass`` [kg]; ``inertia`` [kg m²] about the origin of its frame, which is its centre of mass,
    None for a body that never rotates. ``table`` is Coulomb's coefficient with the table under the body, None for a
    body that glides freely; ``reach`` [m] is the mean distance of the pressure under the body from its centre of
    mass, by default for a pressure that is uniform over its shape.
    """

    mass: Scalar = 1.0
    inertia: Scalar | None = None
    table: Scalar | None = None
    reach: Scalar | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.reach is not None and self.table is None:
            raise ValueError(f"{self.name}: reach is that of a table; give table as well")

    @property
    def coordinates(self) -> tuple[Signal, ...]:
        """Signals ``<name>_x``, ``<name>_y`` and, if the body turns, ``<name>_angle``."""
        position_signals = _position_signals(self.name)
        angle_signal = Signal(f"{self.name}_angle", "rad", f"{self.name}, anticlockwise")
        return (*position_signals, angle_signal) if self.turns else position_signals

    @classmethod
    def uniform(
        cls,
        name: str,
        shape: Shape | Union,
        at: Point,
        angle: Scalar = 0.0,
        mass: Scalar = 1.0,
        table: Scalar | None = None,
    ) -> Body:
        """Return a body of uniform density over ``shape``, with its centre of mass at ``at``.

        The origin of the frame moves to the centroid c, and the inertia is ``mass int |r - c|² dA /
        A``, including rounded corners and all parts of a union. Raises ``ValueError`` for an invalid
        argument.
        """
        area = shape_area(shape)
        shape = move_shape(shape, -area.centre)
        return cls(name, shape, at, angle, mass, mass * area.gyration, table)

    def limit_surface(self, first: int, gravity: Scalar, inertial: bool) -> LimitSurface | None:
        """Return the body's friction with its table, None without a table; ``first`` is the index of its x in q."""
        if self.table is None:
            return None
        reach = (mean_distance(self.shape) if self.reach is None else self.reach) if self.turns else None
        return LimitSurface(self.name, first, self.table * self.mass * gravity, reach, inertial)

    @property
    def turns(self) -> bool:
        """Whether the body can rotate, that is, whether it has an ``inertia``."""
        return self.inertia is not None

    @property
    def start(self) -> ca.SX:
        """Coordinates at the start: ``at`` and, if the body turns, ``angle``."""
        return ca.vertcat(as_column(self.at), self.angle) if self.turns else as_column(self.at)

    def pose(self, q: ca.SX) -> Pose:
        """Return the pose at the coordinates ``q``."""
        return Pose(q[:2], -ca.SX(q[2] if self.turns else self.angle))


@dataclass(frozen=True, eq=False)
class Pusher(Thing):
    """Pusher: an element of a scene that a motor moves and that never rotates.

    In a quasi-dynamic scene a spring of ``stiffness`` [N/m] pulls it to the commanded position; in a
    scene with velocities it has a ``mass`` [kg], and a force moves it. It moves in the plane, or on a
    rail along the unit vector ``axis``, where its distance from ``at`` [m] is the only coordinate.
    """

    stiffness: Scalar | None = None
    mass: Scalar | None = None
    axis: Point | None = None

    @property
    def coordinates(self) -> tuple[Signal, ...]:
        """Signals ``<name>_x`` and ``<name>_y``, or ``<name>`` for the distance along the rail."""
        if self.axis is None:
            return _position_signals(self.name)
        return (Signal(self.name, "m", f"position of {self.name} along its rail"),)

    @property
    def start(self) -> ca.SX:
        """Coordinates at the start: ``at``, or 0 on a rail."""
        return as_column(self.at) if self.axis is None else ca.SX.zeros(1)

    def pose(self, q: ca.SX) -> Pose:
        """Return the pose at the coordinates ``q``."""
        position = q if self.axis is None else as_column(self.at) + q * as_column(self.axis)
        return Pose(position, -ca.SX(self.angle))

    @property
    def directions(self) -> ca.SX:
        """Unit vectors along which the coordinates move the pusher, the columns of (2, n)."""
        return ca.SX.eye(2) if self.axis is None else as_column(self.axis)


@dataclass(frozen=True, eq=False)
class Goal:
    """A goal pose of the body called ``body``; it is drawn with the body's shape and has no contacts."""

    body: str
    at: Point
    angle: Scalar = 0.0

    def __post_init__(self) -> None:
        require_text("the body of a Goal", self.body)
        parse_point(f"goal of {self.body}: at", self.at)
        parse_number(f"goal of {self.body}: angle", self.angle)


def _position_signals(name: str) -> tuple[Signal, ...]:
    return tuple(Signal(f"{name}_{axis}", "m", name) for axis in "xy")


PoseOf = Callable[[Thing], Pose]
MOST_FREE_FIRST = (Body, Pusher, Obstacle)
"""Kinds of things, the most freely moving first; a contact's normal points into the earlier kind."""


@dataclass(frozen=True, eq=False)
class Touch:
    """Contact called ``name`` between ``shape`` of the element ``one`` and the shape ``against`` of ``other``.

    Its normal points into ``one``, the element that moves more freely.
    """

    name: str
    one: Thing
    shape: Shape
    against: Shape
    other: Thing

    def contact(self, pose: PoseOf) -> Contact:
        """Return distance, normal and point of the contact; ``pose`` is a function from an element to its pose."""
        return Contact.between(self.shape, pose(self.one), self.against, pose(self.other))

    @property
    def pair(self) -> frozenset[str]:
        """Names of the two elements in contact."""
        return frozenset((self.one.name, self.other.name))


def contact_pairs(elements: Sequence[Thing], non_colliding: Collection[frozenset[str]]) -> list[Touch]:
    """Return all contacts of two elements, at least one moving, except the pairs of names in ``non_colliding``.

    If one of the two can turn, every corner has a separate contact ``<one> on <other> <number>``, see
    :func:`~dynamics.systems.shapes.polygon.vertex_pairs`.
    """
    pairs_that_touch = []
    for first, second in combinations(elements, 2):
        if isinstance(first, Obstacle) and isinstance(second, Obstacle):
            continue
        if frozenset((first.name, second.name)) in non_colliding:
            continue
        label = f"{first.name} on {second.name}"
        freer, less_free = sorted(
            (first, second), key=lambda element: [not isinstance(element, kind) for kind in MOST_FREE_FIRST]
        )
        pairs = [(a, b) for a in convex_parts(freer.shape) for b in convex_parts(less_free.shape)]
        if freer.turns or less_free.turns:
            pairs = vertex_pairs(freer.shape, less_free.shape)
        names = [label] if len(pairs) == 1 else [f"{label} {i + 1}" for i in range(len(pairs))]
        pairs_that_touch += [Touch(name, freer, *shapes, less_free) for name, shapes in zip(names, pairs, strict=True)]
    return pairs_that_touch
