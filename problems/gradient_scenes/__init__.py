"""Scenes with a gradient in closed form, with which the gradients of simulators are compared."""

from problems.gradient_scenes.scene import Mechanics, Scene
from problems.gradient_scenes.scenes import SCENES

__all__ = ["SCENES", "Mechanics", "Scene"]
