"""Robots from URDF and MJCF files; ``load(path)`` reads one."""

from problems.robots.reading import load
from problems.robots.robot import Robot

__all__ = ["Robot", "load"]
