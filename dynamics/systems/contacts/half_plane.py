"""Everything behind a straight line."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from dynamics.systems.contacts.pose import Point, Pose
from dynamics.systems.contacts.shape import Shape


@dataclass(frozen=True, eq=False)
class HalfPlane(Shape):
    """The half-plane through ``origin`` with outward unit ``normal``, of radius zero."""

    origin: Point = (0.0, 0.0)
    normal: Point = (0.0, 1.0)
    radius = 0.0

    @property
    def corners(self) -> tuple[Point, ...]:
        """None."""
        return ()

    def beside(self, point: ca.SX, pose: Pose) -> tuple[ca.SX, ca.SX]:
        """``normal' (point - origin)``."""
        normal = pose.turn(self.normal)
        return ca.dot(normal, point - pose.place(self.origin)), normal
