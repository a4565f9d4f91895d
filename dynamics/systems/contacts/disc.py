"""A disc."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from dynamics.systems.contacts.pose import Point, Pose, Scalar
from dynamics.systems.contacts.shape import Shape


@dataclass(frozen=True, eq=False)
class Disc(Shape):
    """All points within ``radius`` of ``centre``."""

    radius: Scalar
    centre: Point = (0.0, 0.0)

    @property
    def corners(self) -> tuple[Point, ...]:
        """The centre."""
        return (self.centre,)

    def beside(self, point: ca.SX, pose: Pose) -> tuple[ca.SX, ca.SX]:
        """``|point - centre| - radius``; not differentiable at the centre."""
        apart = point - pose.place(self.centre)
        distance = ca.norm_2(apart)
        return distance - self.radius, apart / distance
