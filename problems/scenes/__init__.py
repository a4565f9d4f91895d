"""Pushing problems built from shapes: objects, their contacts, the contact system and the drawing."""

from dynamics.systems.shapes import Box, Capsule, Disc, HalfPlane, Polygon, Union
from problems.scenes.pictures import drawing_functions
from problems.scenes.scene import Scene
from problems.scenes.things import Body, Goal, Obstacle, Pusher

__all__ = [
    "Body",
    "Box",
    "Capsule",
    "Disc",
    "Goal",
    "HalfPlane",
    "Obstacle",
    "Polygon",
    "Pusher",
    "Scene",
    "Union",
    "drawing_functions",
]
