"""Where bodies of the plane are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca

Scalar = float | ca.SX
Point = tuple[Scalar, Scalar] | ca.SX


@dataclass(frozen=True, eq=False)
class Pose:
    """Where a body is: ``position`` (2, 1) [m] of its origin and ``angle`` [rad].

    The angle counts from the second axis of the plane towards the first, in the plane (x, z)
    about +y: ``R(a)(x, z) = (x cos a + z sin a, -x sin a + z cos a)``. Where a model counts its
    angle the other way round, pass the angle with its sign changed.
    """

    position: ca.SX
    angle: ca.SX

    @classmethod
    def fixed(cls) -> Pose:
        """Return the pose of the world itself, which never moves."""
        return cls(ca.SX.zeros(2), ca.SX(0))

    @cached_property
    def cos(self) -> ca.SX:
        """Cosine of the angle."""
        return ca.cos(self.angle)

    @cached_property
    def sin(self) -> ca.SX:
        """Sine of the angle."""
        return ca.sin(self.angle)

    def turn(self, vector: Point) -> ca.SX:
        """Turn a vector of the body's frame into the world's, R(angle) vector."""
        x, z = vector[0], vector[1]
        return ca.vertcat(x * self.cos + z * self.sin, z * self.cos - x * self.sin)

    def place(self, point: Point) -> ca.SX:
        """Return where a point of the body is in the world, (2, 1) [m]."""
        return self.position + self.turn(point)

    def local(self, point: Point) -> ca.SX:
        """Coordinates (2, 1) of a world point in the body's frame [m]."""
        x, z = point[0] - self.position[0], point[1] - self.position[1]
        return ca.vertcat(x * self.cos - z * self.sin, x * self.sin + z * self.cos)


def column(point: Point) -> ca.SX:
    """A point as (2, 1)."""
    return point if isinstance(point, ca.SX) else ca.vertcat(*(ca.SX(value) for value in point))
