"""Shapes in the picture of a problem, as plain data; the package ``reports`` draws them.

Lengths are in metres, angles in radians. Shapes are immutable and can be compared, so that a
shape that does not change with time (a wall, a goal) can be drawn once. ``role`` is ``"object"``,
``"actuator"``, ``"environment"`` or ``"goal"``.

In a picture in perspective (:mod:`problems.machines.perspective`), a shape hides the shapes before it
in the list. Its ``shade`` is its darkness, up to 1 for the full colour of the role; shapes of shade 0 are
transparent. Shaded segments are lines on a floor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from dynamics.systems import shapes
from dynamics.systems.shapes import Point
from ocp.validation import NotNegative, Number

Shade = Annotated[float, Field(ge=0, le=1)]
Role = Annotated[str, Field(pattern="^(object|actuator|environment|goal)$")]


@dataclass(frozen=True)
class Circle:
    """A filled circle around (x, y)."""

    x: Number
    y: Number
    radius: NotNegative
    role: Role = "object"
    shade: Shade = 0.0


@dataclass(frozen=True)
class Rectangle:
    """A rectangle centred at (x, y), turned counter-clockwise by ``angle``.

    ``width`` and ``height`` are outer dimensions, which include ``rounding``, the radius of the
    corners.
    """

    x: Number
    y: Number
    width: NotNegative
    height: NotNegative
    angle: Number = 0.0
    role: Role = "object"
    rounding: NotNegative = 0.0


@dataclass(frozen=True)
class Outline:
    """A convex polygon with ``corners`` (counter-clockwise), expanded by ``radius`` on all sides."""

    corners: tuple[tuple[float, float], ...]
    radius: NotNegative = 0.0
    role: Role = "object"
    shade: Shade = 0.0

    def __post_init__(self) -> None:
        # Corners that are read from a stored run are lists, which cannot be hashed.
        object.__setattr__(self, "corners", tuple((x, y) for x, y in self.corners))


@dataclass(frozen=True)
class Stadium:
    """A link with round ends: all points within ``radius`` of the segment (x1, y1) to (x2, y2)."""

    x1: Number
    y1: Number
    x2: Number
    y2: Number
    radius: NotNegative
    role: Role = "object"
    shade: Shade = 0.0


@dataclass(frozen=True)
class Segment:
    """A straight bar from (x1, y1) to (x2, y2)."""

    x1: Number
    y1: Number
    x2: Number
    y2: Number
    role: Role = "object"
    shade: Shade = 0.0


@dataclass(frozen=True)
class Spring:
    """A spring from (x1, y1) to (x2, y2)."""

    x1: Number
    y1: Number
    x2: Number
    y2: Number
    role: Role = "environment"


@dataclass(frozen=True)
class Mark:
    """A mark that shows the point (x, y)."""

    x: Number
    y: Number
    role: Role = "object"


@dataclass(frozen=True)
class Wall:
    """The half-plane behind the line through (x, y) with the outward normal (nx, ny).

    A floor at height zero is ``Wall(0, 0, 0, 1)``.
    """

    x: Number
    y: Number
    nx: Number
    ny: Number
    role: Role = "environment"


Shape = Circle | Rectangle | Outline | Stadium | Segment | Spring | Mark | Wall
STORED_KINDS: dict[str, type[Shape]] = {
    "Disc": Circle,
    "Box": Rectangle,
    "Polygon": Outline,
    "Capsule": Stadium,
    "HalfPlane": Wall,
    **{kind.__name__: kind for kind in (Segment, Spring, Mark)},
}
"""Mapping from the word that a run stores for a shape to the shape's class."""


@dataclass(frozen=True)
class ContactFrame:
    """Point at which a contact acts, with its unit normal and tangent.

    The object is pushed at (x, y) by ``normal_impulse * normal + friction_impulse * tangent``;
    normal = (nx, ny) points into the object and tangent = (ny, -nx) is the normal turned by -90
    degrees: over a floor, whose normal points up, the tangent points to positive x. A contact
    without friction pushes by ``lam * normal``.

    ``friction`` is Coulomb's coefficient; the force lies within atan(friction) of the normal.

    ``flat`` is False for a contact drawn in perspective: its normal has the projected length, and
    only the normal part of the force is drawn.
    """

    x: Number
    y: Number
    nx: Number
    ny: Number
    friction: NotNegative = 0.0
    flat: bool = True

    @property
    def tangent(self) -> tuple[float, float]:
        """Unit tangent, the normal turned by -90 degrees."""
        return self.ny, -self.nx

    def force(self, normal: float, friction: float) -> tuple[float, float]:
        """Return the force (x, y) on the object from its components along normal and tangent, in the same unit."""
        tx, ty = self.tangent
        return normal * self.nx + friction * tx, normal * self.ny + friction * ty


def solid(shape: shapes.Shape, x: float, y: float, angle: float, role: str = "object") -> Shape:
    """Return the drawing of ``shape``, whose sizes must be numbers, on a body at (x, y) [m].

    ``angle`` [rad] is clockwise, as in :class:`~dynamics.systems.shapes.Pose`.
    """
    cos, sin = math.cos(angle), math.sin(angle)

    def rotated(vector: Point) -> tuple[float, float]:
        a, b = float(vector[0]), float(vector[1])
        return a * cos + b * sin, b * cos - a * sin

    def placed(point: Point) -> tuple[float, float]:
        right, up = rotated(point)
        return x + right, y + up

    match shape:
        case shapes.Disc(radius, centre):
            return Circle(*placed(centre), float(radius), role)
        case shapes.Capsule(start, end, radius):
            return Stadium(*placed(start), *placed(end), float(radius), role)
        case shapes.HalfPlane(origin, normal):
            return Wall(*placed(origin), *rotated(normal), role)
        case shapes.Box(half, radius, centre):
            size = 2 * float(half[0]), 2 * float(half[1])
            return Rectangle(*placed(centre), *size, -angle, role, float(radius))
        case shapes.Polygon(_, radius):
            return Outline(tuple(placed(corner) for corner in shape.corners), float(radius), role)
    raise TypeError(f"cannot draw a {type(shape).__name__}")
