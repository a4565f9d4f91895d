"""Poses and shapes of bodies in the plane, and signed distances of points from shapes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from dynamics.systems.checks import parse_point, require_not_negative, require_positive, require_unit_vector

Scalar = float | ca.SX
Point = tuple[Scalar, Scalar] | ca.SX


@dataclass(frozen=True, eq=False)
class Pose:
    """Pose of a body in the plane: ``position`` (2, 1) [m] of its origin and ``angle`` [rad].

    The angle is measured from the second axis of the plane towards the first, in the plane (x, z) about +y:
    ``R(a)(x, z) = (x cos a + z sin a, -x sin a + z cos a)``. If a model measures its angle in the opposite
    direction, pass the negative angle.
    """

    position: ca.SX
    angle: ca.SX

    @classmethod
    def fixed(cls) -> Pose:
        """Return the pose of the world frame, which never moves."""
        return cls(ca.SX.zeros(2), ca.SX(0))

    @cached_property
    def cos(self) -> ca.SX:
        """Cosine of the angle."""
        return ca.cos(self.angle)

    @cached_property
    def sin(self) -> ca.SX:
        """Sine of the angle."""
        return ca.sin(self.angle)

    def rotate(self, vector: Point) -> ca.SX:
        """Convert a vector from the body's axes to the world's axes (2, 1), ``R(angle) vector``."""
        x, z = vector[0], vector[1]
        return ca.vertcat(x * self.cos + z * self.sin, z * self.cos - x * self.sin)

    def to_world(self, point: Point) -> ca.SX:
        """Return the world position (2, 1) [m] of a point of the body's frame."""
        return self.position + self.rotate(point)

    def to_local(self, point: Point) -> ca.SX:
        """Coordinates (2, 1) of a world point in the body's frame [m]."""
        x, z = point[0] - self.position[0], point[1] - self.position[1]
        return ca.vertcat(x * self.cos - z * self.sin, x * self.sin + z * self.cos)


def as_column(point: Point) -> ca.SX:
    """Return a point as a column (2, 1)."""
    return point if isinstance(point, ca.SX) else ca.vertcat(*(ca.SX(value) for value in point))


class Shape(ABC):
    """A convex shape in the frame of a body: all points within ``radius`` [m] of a convex core."""

    radius: Scalar

    @property
    @abstractmethod
    def corners(self) -> tuple[Point, ...]:
        """Corners of the core in the body's frame [m]; empty if the core is unbounded."""

    @abstractmethod
    def signed_distance(self, point: ca.SX, pose: Pose) -> tuple[ca.SX, ca.SX]:
        """Return the signed distance [m] of a world point from the surface, and the outward unit normal (2, 1)."""


@dataclass(frozen=True, eq=False)
class Box(Shape):
    """A box with half side lengths ``half_size`` around ``centre``, corners rounded by ``radius``.

    Raises ``ValueError`` for invalid sizes or an invalid centre.
    """

    half_size: Point
    radius: Scalar = 0.0
    centre: Point = (0.0, 0.0)

    def __post_init__(self) -> None:
        parse_point("Box half_size", self.half_size)
        require_positive("Box half_size", self.half_size[0], self.half_size[1])
        require_not_negative("Box radius", self.radius)
        parse_point("Box centre", self.centre)

    @property
    def corners(self) -> tuple[Point, ...]:
        """Centres of the four rounded corners in the body's frame [m]."""
        x, z, r = self.centre[0], self.centre[1], self.radius
        a, b = self.half_size[0] - r, self.half_size[1] - r
        return ((x + a, z + b), (x - a, z + b), (x - a, z - b), (x + a, z - b))

    def signed_distance(self, point: ca.SX, pose: Pose) -> tuple[ca.SX, ca.SX]:
        """Return the distance ``|max(d, 0)| + min(max(d_1, d_2), 0) - radius`` [m] and the normal (2, 1).

        ``d = |p| - half_size + radius``, p the point relative to the centre in the box's axes. Outside
        the normal points away from the nearest point of the box, inside towards the nearest side. Inside, the
        distance is not differentiable where two sides are equally near.
        """
        p = pose.to_local(point) - as_column(self.centre)
        side = ca.if_else(p >= 0, 1, -1)
        d = side * p - as_column(self.half_size) + self.radius
        at_corner = ca.logic_and(d[0] > 0, d[1] > 0)
        # Away from a corner the root's argument is 1, as its slope at 0 would be infinite.
        to_corner = ca.sqrt(ca.if_else(at_corner, ca.sumsqr(d), 1))
        is_first_nearer = d[0] > d[1]
        distance = ca.if_else(at_corner, to_corner, ca.if_else(is_first_nearer, d[0], d[1]))
        facing = ca.vertcat(is_first_nearer, ca.logic_not(is_first_nearer))
        normal = side * ca.if_else(at_corner, d / to_corner, facing)
        return distance - self.radius, pose.rotate(normal)


@dataclass(frozen=True, eq=False)
class Capsule(Shape):
    """A capsule: all points within ``radius`` [m] of the segment from ``start`` to ``end``.

    Raises ``ValueError`` for invalid points or an invalid radius.
    """

    start: Point
    end: Point
    radius: Scalar

    def __post_init__(self) -> None:
        parse_point("Capsule start", self.start)
        parse_point("Capsule end", self.end)
        require_positive("Capsule radius", self.radius)

    @property
    def corners(self) -> tuple[Point, ...]:
        """The two ends of the segment in the body's frame [m]."""
        return (self.start, self.end)

    def signed_distance(self, point: ca.SX, pose: Pose) -> tuple[ca.SX, ca.SX]:
        """Return ``|point - nearest point of the segment| - radius`` and the normal (undefined on the segment)."""
        start = pose.to_world(self.start)
        segment = pose.to_world(self.end) - start
        share = ca.fmin(ca.fmax(ca.dot(point - start, segment) / ca.sumsqr(segment), 0), 1)
        offset = point - (start + share * segment)
        distance = ca.norm_2(offset)
        return distance - self.radius, offset / distance


@dataclass(frozen=True, eq=False)
class Disc(Shape):
    """A disc: all points within ``radius`` [m] of ``centre``; the radius 0 gives a point.

    Raises ``ValueError`` for an invalid radius or centre.
    """

    radius: Scalar
    centre: Point = (0.0, 0.0)

    def __post_init__(self) -> None:
        require_not_negative("Disc radius", self.radius)
        parse_point("Disc centre", self.centre)

    @property
    def corners(self) -> tuple[Point, ...]:
        """Centre of the disc in the body's frame [m], the only corner of the core."""
        return (self.centre,)

    def signed_distance(self, point: ca.SX, pose: Pose) -> tuple[ca.SX, ca.SX]:
        """Return ``|point - centre| - radius`` and the normal, which is undefined at the centre."""
        offset = point - pose.to_world(self.centre)
        distance = ca.norm_2(offset)
        return distance - self.radius, offset / distance


@dataclass(frozen=True, eq=False)
class HalfPlane(Shape):
    """The half-plane bounded by the line through ``origin`` with the outward unit ``normal``; its radius is zero.

    Raises ``ValueError`` for an invalid origin, or a normal whose length is not 1.
    """

    origin: Point = (0.0, 0.0)
    normal: Point = (0.0, 1.0)
    radius = 0.0

    def __post_init__(self) -> None:
        parse_point("HalfPlane origin", self.origin)
        require_unit_vector("HalfPlane normal", parse_point("HalfPlane normal", self.normal))

    @property
    def corners(self) -> tuple[Point, ...]:
        """Corners of an unbounded core: an empty tuple."""
        return ()

    def signed_distance(self, point: ca.SX, pose: Pose) -> tuple[ca.SX, ca.SX]:
        """Return the distance ``normal' (point - origin)`` [m] and the normal (2, 1)."""
        normal = pose.rotate(self.normal)
        return ca.dot(normal, point - pose.to_world(self.origin)), normal
