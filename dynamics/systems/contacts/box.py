"""A box with rounded corners."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from dynamics.systems.contacts.pose import Point, Pose, Scalar, column
from dynamics.systems.contacts.shape import Shape


@dataclass(frozen=True, eq=False)
class Box(Shape):
    """A box with half side lengths ``half_size``, corners rounded by ``radius``.

    The origin of the body is in its middle.
    """

    half_size: Point
    radius: Scalar = 0.0

    @property
    def corners(self) -> tuple[Point, ...]:
        """The centres of the four rounded corners."""
        x, z = (self.half_size[i] - self.radius for i in range(2))
        return ((x, z), (-x, z), (-x, -z), (x, -z))

    def beside(self, point: ca.SX, pose: Pose) -> tuple[ca.SX, ca.SX]:
        """With p the point in the box's frame and ``d = |p| - half_size + radius``,

        ``|max(d, 0)| + min(max(d_1, d_2), 0) - radius``; outside the normal points from the nearest
        point, inside towards the nearest side. Not differentiable where two sides are equally near
        inside.
        """
        p = pose.local(point)
        side = ca.if_else(p >= 0, 1, -1)
        d = side * p - column(self.half_size) + self.radius
        at_corner = ca.logic_and(d[0] > 0, d[1] > 0)
        # Away from a corner the root's argument is 1, as its slope at 0 would be infinite.
        to_corner = ca.sqrt(ca.if_else(at_corner, ca.sumsqr(d), 1))
        first = d[0] > d[1]
        distance = ca.if_else(at_corner, to_corner, ca.if_else(first, d[0], d[1]))
        facing = ca.vertcat(first, ca.logic_not(first))
        normal = side * ca.if_else(at_corner, d / to_corner, facing)
        return distance - self.radius, pose.turn(normal)
