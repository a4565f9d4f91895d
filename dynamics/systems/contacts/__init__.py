"""Contacts between shapes of the plane: one object with all its maps, one shape a file."""

from dynamics.systems.contacts.box import Box
from dynamics.systems.contacts.capsule import Capsule
from dynamics.systems.contacts.contact import Contact
from dynamics.systems.contacts.disc import Disc
from dynamics.systems.contacts.half_plane import HalfPlane
from dynamics.systems.contacts.pose import Point, Pose
from dynamics.systems.contacts.shape import Shape

__all__ = ["Box", "Capsule", "Contact", "Disc", "HalfPlane", "Point", "Pose", "Shape"]
