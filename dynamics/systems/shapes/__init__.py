"""Shapes in the plane and the contacts between them, with distance, normal, point and Jacobians."""

from dynamics.systems.shapes.contact import Contact
from dynamics.systems.shapes.planar import Box, Capsule, Disc, HalfPlane, Point, Pose, Shape
from dynamics.systems.shapes.polygon import Polygon, Union

__all__ = [
    "Box",
    "Capsule",
    "Contact",
    "Disc",
    "HalfPlane",
    "Point",
    "Polygon",
    "Pose",
    "Shape",
    "Union",
]
