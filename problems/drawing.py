"""Shapes of a picture of a problem, as plain data: the reports decide how to draw them.

Lengths in metres, angles in radians. Every shape is a frozen value, so those of several instants
that are equal (walls, goals) can be drawn once. ``role`` is ``"object"``, ``"actuator"``,
``"environment"`` or ``"goal"``.

A picture of space (:mod:`problems.machines.perspective`) needs shapes that hide what comes before
them in their list. These have a ``shade``: how dark, up to 1 for the full colour of the role; with
the shade 0 one sees through. Shaded segments are lines on a floor.
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

    ``width`` and ``height`` are outer measures; ``rounding`` is the radius of the corners, which
    lies within them.
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
    """A convex polygon with the ``corners`` of its core, counter-clockwise, grown by ``radius``."""

    corners: tuple[tuple[float, float], ...]
    radius: NotNegative = 0.0
    role: Role = "object"
    shade: Shade = 0.0

    def __post_init__(self) -> None:
        # Those of a stored run are lists, which have no hash.
        object.__setattr__(self, "corners", tuple((x, y) for x, y in self.corners))


@dataclass(frozen=True)
class Stadium:
    """A link with round ends: all within ``radius`` of the segment (x1, y1) to (x2, y2)."""

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
    """A mark at (x, y)."""

    x: Number
    y: Number
    role: Role = "object"


@dataclass(frozen=True)
class Wall:
    """Everything on the side of the line through (x, y) that its normal (nx, ny) points away from.

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
"""Shapes by the words under which runs store them."""


@dataclass(frozen=True)
class ContactFrame:
    """The place at which a contact acts, and its unit directions.

    The object is pushed at (x, y) by ``normal_impulse * normal + friction_impulse * tangent``;
    normal = (nx, ny) points into the object and tangent = (ny, -nx) is the normal turned by -90
    degrees: over a floor, whose normal points up, the tangent points to positive x. A contact
    without friction pushes by ``lam * normal``.

    ``friction`` is Coulomb's coefficient; the force lies within atan(friction) of the normal.

    A frame seen in space is not ``flat``: its normal is as long as it looks, and of its force the
    normal part alone is drawn.
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


def solid(shape: shapes.Shape, x: float, y: float, angle: float, role: str = "object") -> Shape:
    """Draw ``shape``, whose numbers are no symbols, on a body at (x, y).

    ``angle`` counts as that of a :class:`~dynamics.systems.shapes.Pose`: clockwise.
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
