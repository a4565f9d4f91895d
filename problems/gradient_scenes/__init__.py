"""Scenes with a gradient in closed form, with which the gradients of simulators are compared."""

from __future__ import annotations

from problems.gradient_scenes.falling import BOUNCE, CORNER, OBLIQUE_DROP
from problems.gradient_scenes.meeting import PENDULUM_STOP, PUSH_FROM_AFAR, TWO_BALLS
from problems.gradient_scenes.scene import Mechanics, Scene
from problems.gradient_scenes.sliding import SLIDE_TO_REST, STICK_SLIP, WALL_SPRING

SCENES: dict[str, Scene] = {
    scene.name: scene
    for scene in (
        OBLIQUE_DROP,
        BOUNCE,
        SLIDE_TO_REST,
        WALL_SPRING,
        TWO_BALLS,
        PENDULUM_STOP,
        CORNER,
        PUSH_FROM_AFAR,
        STICK_SLIP,
    )
}
"""Mapping from the name of a scene to the scene."""


__all__ = ["SCENES", "Mechanics", "Scene"]
