"""Shapes of contacts as they are drawn, where their bodies are."""

from __future__ import annotations

import math

from dynamics.systems import contacts
from dynamics.systems.contacts import Point
from problems.drawing import Box, Capsule, Disc, HalfPlane, Shape


def solid(shape: contacts.Shape, x: float, y: float, angle: float, role: str = "object") -> Shape:
    """Draw ``shape``, whose numbers are no symbols, on a body at (x, y).

    ``angle`` counts as that of a :class:`~dynamics.systems.contacts.Pose`: clockwise.
    """
    cos, sin = math.cos(angle), math.sin(angle)

    def turned(vector: Point) -> tuple[float, float]:
        a, b = float(vector[0]), float(vector[1])
        return a * cos + b * sin, b * cos - a * sin

    def placed(point: Point) -> tuple[float, float]:
        right, up = turned(point)
        return x + right, y + up

    match shape:
        case contacts.Disc(radius, centre):
            return Disc(*placed(centre), float(radius), role)
        case contacts.Capsule(start, end, radius):
            return Capsule(*placed(start), *placed(end), float(radius), role)
        case contacts.HalfPlane(origin, normal):
            return HalfPlane(*placed(origin), *turned(normal), role)
        case contacts.Box(half, radius):
            size = 2 * float(half[0]), 2 * float(half[1])
            return Box(x, y, *size, -angle, role, float(radius))
    raise TypeError(f"no way to draw a {type(shape).__name__}")
