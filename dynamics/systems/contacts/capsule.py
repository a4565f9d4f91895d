"""A capsule: a segment with round ends."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from dynamics.systems.contacts.pose import Point, Pose, Scalar
from dynamics.systems.contacts.shape import Shape


@dataclass(frozen=True, eq=False)
class Capsule(Shape):
    """All points within ``radius`` of the segment from ``start`` to ``end``."""

    start: Point
    end: Point
    radius: Scalar

    @property
    def corners(self) -> tuple[Point, ...]:
        """Both ends of the segment."""
        return (self.start, self.end)

    def beside(self, point: ca.SX, pose: Pose) -> tuple[ca.SX, ca.SX]:
        """``|point - nearest of the segment| - radius``; not differentiable on the segment."""
        foot = pose.place(self.start)
        along = pose.place(self.end) - foot
        share = ca.fmin(ca.fmax(ca.dot(point - foot, along) / ca.sumsqr(along), 0), 1)
        apart = point - (foot + share * along)
        distance = ca.norm_2(apart)
        return distance - self.radius, apart / distance
