"""Contacts between shapes of the plane: one object with all its maps."""

from dynamics.systems.contacts.contact import Contact
from dynamics.systems.contacts.polygon import Polygon, Union
from dynamics.systems.contacts.shapes import Box, Capsule, Disc, HalfPlane, Point, Pose, Shape

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
