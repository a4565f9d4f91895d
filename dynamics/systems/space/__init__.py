"""Machines in space: bodies, joints, shapes, and their equations of motion."""

from dynamics.systems.mechanism import WORLD
from dynamics.systems.space.body import Body
from dynamics.systems.space.contact import SpatialContact
from dynamics.systems.space.coupling import Coupling
from dynamics.systems.space.machine import SpatialMachine, SpatialPart
from dynamics.systems.space.shapes import Box, Capsule, Cylinder, Hull, Plane, Shape, Sphere
from dynamics.systems.space.tree import Tree

__all__ = [
    "WORLD",
    "Body",
    "Box",
    "Capsule",
    "Coupling",
    "Cylinder",
    "Hull",
    "Plane",
    "Shape",
    "SpatialContact",
    "SpatialMachine",
    "SpatialPart",
    "Sphere",
    "Tree",
]
