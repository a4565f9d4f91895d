"""Signed distance between shapes of the plane, with normal, tangent and point of contact."""

from __future__ import annotations

from dataclasses import dataclass

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

    def turn(self, vector: Point) -> ca.SX:
        """Turn a vector of the body's frame into the world's, R(angle) vector."""
        c, s = ca.cos(self.angle), ca.sin(self.angle)
        return ca.vertcat(vector[0] * c + vector[1] * s, vector[1] * c - vector[0] * s)

    def local(self, point: Point) -> ca.SX:
        """Coordinates (2, 1) of a world point in the body's frame [m]."""
        c, s = ca.cos(self.angle), ca.sin(self.angle)
        x, z = point[0] - self.position[0], point[1] - self.position[1]
        return ca.vertcat(x * c - z * s, x * s + z * c)


@dataclass(frozen=True, eq=False)
class ContactGeometry:
    """How a disc A is near a body B.

    ``phi`` signed distance [m], negative in penetration; ``normal`` (2, 1) unit vector out of B
    towards A; ``tangent`` (2, 1) the normal turned by a right angle, ``(n_z, -n_x)``, so that on
    a floor it points forward; ``point`` (2, 1) [m] the point of A nearest to B. The nearest
    point of B is ``point - phi normal``.
    """

    phi: ca.SX
    normal: ca.SX
    point: ca.SX

    @property
    def tangent(self) -> ca.SX:
        """Unit vector along the surface of B (2, 1)."""
        return ca.vertcat(self.normal[1], -self.normal[0])

    def jacobians(self, a: Pose, b: Pose, q: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Rows ``J_n`` and ``J_t``, each (1, nq), of the relative velocity at the contact.

        ``J_n dq/dt`` and ``J_t dq/dt`` are normal and tangential part of the velocity of A's
        material point less that of B's [m/s], both taken at ``point``: a force and its reaction
        then act along one line. ``J_n`` is the gradient of ``phi`` where ``a`` and ``b`` are the
        poses that it was computed from. q must be symbols.
        """
        slip = _point_jacobian(a, self.point, q) - _point_jacobian(b, self.point, q)
        # A floor's normal has a zero in it, which would else leave columns of explicit zeros.
        return ca.sparsify(self.normal.T @ slip), ca.sparsify(self.tangent.T @ slip)


def _point_jacobian(body: Pose, point: ca.SX, q: ca.SX) -> ca.SX:
    arm = point - body.position
    swing = ca.vertcat(arm[1], -arm[0])
    return ca.jacobian(body.position, q) + swing @ ca.jacobian(body.angle, q)


def disc_half_plane(centre: Point, radius: Scalar, origin: Point, normal: Point) -> ContactGeometry:
    """Disc above the half-plane through ``origin`` with outward unit ``normal``.

    ``phi = normal' (centre - origin) - radius``.
    """
    c, n = _column(centre), _column(normal)
    return _touch(c, radius, ca.dot(n, c - _column(origin)), n)


def disc_disc(
    centre: Point, radius: Scalar, other_centre: Point, other_radius: Scalar
) -> ContactGeometry:
    """Disc beside another disc, ``phi = |centre - other_centre| - radius - other_radius``.

    Not differentiable where the centres coincide.
    """
    c = _column(centre)
    apart = c - _column(other_centre)
    distance = ca.norm_2(apart)
    return _touch(c, radius, distance - other_radius, apart / distance)


def disc_capsule(
    centre: Point, radius: Scalar, start: Point, end: Point, capsule_radius: Scalar
) -> ContactGeometry:
    """Disc beside all points within ``capsule_radius`` of the segment from ``start`` to ``end``.

    ``phi = |centre - nearest point of the segment| - radius - capsule_radius``. Not
    differentiable where the centre lies on the segment.
    """
    c, foot = _column(centre), _column(start)
    along = _column(end) - foot
    share = ca.fmin(ca.fmax(ca.dot(c - foot, along) / ca.sumsqr(along), 0), 1)
    return disc_disc(c, radius, foot + share * along, capsule_radius)


def disc_box(
    centre: Point, radius: Scalar, box: Pose, half_size: Point, corner_radius: Scalar = 0.0
) -> ContactGeometry:
    """Disc at a box with half side lengths ``half_size`` and rounded corners, origin in its middle.

    With p the centre in the box's frame and ``d = |p| - half_size + corner_radius``,
    ``phi = |max(d, 0)| + min(max(d_1, d_2), 0) - corner_radius - radius``; outside the normal
    points from the nearest point, inside towards the nearest side. Not differentiable where two
    sides are equally near inside.
    """
    c, half = _column(centre), _column(half_size)
    p = box.local(c)
    side = ca.if_else(p >= 0, 1, -1)
    d = side * p - half + corner_radius
    at_corner = ca.logic_and(d[0] > 0, d[1] > 0)
    # Away from a corner the root's argument is 1, as its slope at 0 would be infinite.
    to_corner = ca.sqrt(ca.if_else(at_corner, ca.sumsqr(d), 1))
    first = d[0] > d[1]
    distance = ca.if_else(at_corner, to_corner, ca.if_else(first, d[0], d[1]))
    facing = ca.vertcat(first, ca.logic_not(first))
    normal = side * ca.if_else(at_corner, d / to_corner, facing)
    return _touch(c, radius, distance - corner_radius, box.turn(normal))


def _touch(centre: ca.SX, radius: Scalar, distance: ca.SX, normal: ca.SX) -> ContactGeometry:
    """Contact of a disc whose centre is at a signed ``distance`` from a body's surface."""
    return ContactGeometry(distance - radius, normal, centre - radius * normal)


def _column(point: Point) -> ca.SX:
    return point if isinstance(point, ca.SX) else ca.vertcat(*(ca.SX(value) for value in point))
