"""Contacts between shapes in space: distance, normal, point and Jacobian rows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from dynamics.systems.space import rotation
from dynamics.systems.space.body import Vector
from dynamics.systems.space.shapes import Box, Capsule, Cylinder, Hull, Plane, Shape, Sphere

JointAxes = list[tuple[int, ca.SX, ca.SX, ca.SX]]
"""Joint axes that move a body, as :meth:`~dynamics.systems.space.tree.Tree.joint_axes` returns them."""
_FLAT = 1e-3
"""Sine of the angle between a cylinder's axis and a plane's normal below which its lowest point is smoothed."""
_DOWN = -0.7
"""z component of a normal below which the tangents are those of the mirrored basis."""


class SpatialPose(NamedTuple):
    """Frame of a shape: rotation (3, 3) into the world's axes, and origin (3, 1) [m]."""

    R: ca.SX
    p: ca.SX

    def to_world(self, point: Vector) -> ca.SX:
        """Return the world position (3, 1) [m] of a point of the frame."""
        return self.p + self.R @ ca.sparsify(ca.SX(ca.vertcat(*point)))


@dataclass(frozen=True, eq=False)
class SpatialContact:
    """Contact of a shape A with a shape B in space.

    ``phi`` signed distance [m], negative in penetration; ``normal`` (3, 1) unit vector out of B
    towards A; ``point`` (3, 1) [m] the point of A nearest to B.
    """

    phi: ca.SX
    normal: ca.SX
    point: ca.SX

    @property
    def tangents(self) -> tuple[ca.SX, ca.SX]:
        """Two unit vectors along the surface of B; on a floor they are (1, 0, 0) and (0, 1, 0).

        Frisvad's basis, doi 10.1080/2165347X.2012.689606, mirrored for normals that point down, where it is singular.
        """
        x, y, z = ca.vertsplit(self.normal)
        side = ca.if_else(z > _DOWN, 1, -1)
        a = -1 / (1 + side * z)
        b = x * y * a
        first = ca.vertcat(1 + x * x * a, b, -side * x)
        second = ca.vertcat(side * b, side * (1 + y * y * a), -y)
        return ca.sparsify(first), ca.sparsify(second)

    def jacobian_rows(self, motions_a: JointAxes, motions_b: JointAxes, nv: int) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return rows (1, nv) of the relative velocity at ``point``, along the normal and both tangents.

        ``motions_a`` and ``motions_b`` are the axes that move A and B. A force and its reaction act along one line.
        """
        rows = [ca.SX(1, nv) for _ in range(3)]
        for row, direction in zip(rows, (self.normal, *self.tangents), strict=True):
            for sign, motions in ((1, motions_a), (-1, motions_b)):
                for index, rotation_axis, translation_axis, pivot in motions:
                    arm = ca.cross(self.point - pivot, direction)
                    row[index] += sign * (ca.dot(rotation_axis, arm) + ca.dot(translation_axis, direction))
        return rows[0], rows[1], rows[2]


def contacts_between(shape_a: Shape, pose_a: SpatialPose, shape_b: Shape, pose_b: SpatialPose) -> list[SpatialContact]:
    """Return the contacts of two shapes, one for each point where they may touch.

    Spheres and capsules may touch all shapes except hulls. Boxes and hulls may touch planes with their
    corners, and cylinders may touch planes with the lowest point of either rim. A capsule touches planes, boxes and
    cylinders with its two ends. Raises ``ValueError`` for other pairs.
    """
    if isinstance(shape_b, Sphere | Capsule) and not isinstance(shape_a, Sphere):
        shape_a, pose_a, shape_b, pose_b, is_swapped = shape_b, pose_b, shape_a, pose_a, True
    else:
        is_swapped = False
    if isinstance(shape_a, Plane):
        shape_a, pose_a, shape_b, pose_b, is_swapped = shape_b, pose_b, shape_a, pose_a, not is_swapped
    contacts = _find_contacts(shape_a, pose_a, shape_b, pose_b)
    if not contacts:
        kinds = f"{type(shape_a).__name__} and {type(shape_b).__name__}"
        raise ValueError(f"a contact of {kinds} is not known; take spheres or capsules for one")
    swapped = [SpatialContact(c.phi, -c.normal, c.point - c.phi * c.normal) for c in contacts]
    return swapped if is_swapped else contacts


def at_random_poses(rows: ca.SX) -> np.ndarray:
    """Return values (m, 3 n) of an expression (m, n) at three random values of all its symbols."""
    symbols = ca.vertcat(ca.SX(0, 1), *ca.symvar(rows))
    evaluate, rng = ca.Function("rows", [symbols], [ca.densify(rows)]), np.random.default_rng(0)
    return np.hstack([evaluate(rng.uniform(0.1, 1, symbols.numel())).full() for _ in range(3)])


def _find_contacts(shape_a: Shape, pose_a: SpatialPose, shape_b: Shape, pose_b: SpatialPose) -> list[SpatialContact]:
    match shape_a, shape_b:
        case _, Plane():
            normal = ca.sparsify(pose_b.R @ ca.SX(ca.vertcat(*shape_b.normal)))
            origin = pose_b.to_world(shape_b.origin)
            return [
                _contact(ca.dot(normal, centre - origin), normal, centre, radius)
                for centre, radius in _lowest(shape_a, pose_a, normal)
            ]
        case Capsule(), Capsule():
            s, t = _nearest_on_segments(shape_a, pose_a, shape_b, pose_b)
            return [_of_points(s, shape_a.radius, t, shape_b.radius)]
        case Capsule(), Sphere():
            centre = pose_b.to_world(shape_b.centre)
            return [_of_points(_on_segment(shape_a, pose_a, centre), shape_a.radius, centre, shape_b.radius)]
        case ((Sphere() | Capsule()), _):
            distance_function = _DISTANCE_FUNCTIONS.get(type(shape_b))
            ends = [shape_a.centre] if isinstance(shape_a, Sphere) else [shape_a.start, shape_a.end]
            if distance_function is None:
                return []
            contacts = []
            for centre in (pose_a.to_world(end) for end in ends):
                distance, normal = distance_function(shape_b, pose_b, centre)
                contacts.append(_contact(distance, normal, centre, shape_a.radius))
            return contacts
    return []


def _contact(distance: ca.SX, normal: ca.SX, centre: ca.SX, radius: ca.SX | float) -> SpatialContact:
    """Return the contact of B with a sphere whose centre is at ``distance`` from B."""
    return SpatialContact(distance - radius, normal, centre - radius * normal)


def _of_points(point_a: ca.SX, radius: ca.SX | float, point_b: ca.SX, other_radius: ca.SX | float) -> SpatialContact:
    """Return the contact of two spheres, given their centres and radii."""
    offset = point_a - point_b
    distance = ca.norm_2(offset)
    return _contact(distance - other_radius, offset / distance, point_a, radius)


def _lowest(shape: Shape, pose: SpatialPose, normal: ca.SX) -> list[tuple[ca.SX, ca.SX | float]]:
    """Return the points of a shape that may touch a plane first, and for each the radius of the sphere around it."""
    match shape:
        case Sphere():
            return [(pose.to_world(shape.centre), shape.radius)]
        case Capsule():
            return [(pose.to_world(end), shape.radius) for end in (shape.start, shape.end)]
        case Box():
            return [(pose.to_world(corner), 0.0) for corner in box_corners(shape)]
        case Hull():
            return [(pose.to_world(point), 0.0) for point in shape.points]
        case Cylinder():
            axis = pose.to_world(shape.end) - pose.to_world(shape.start)
            axis /= ca.norm_2(axis)
            toward_plane = ca.dot(normal, axis) * axis - normal
            toward_plane = shape.radius * toward_plane / ca.sqrt(ca.sumsqr(toward_plane) + _FLAT**2)
            return [(pose.to_world(end) + toward_plane, 0.0) for end in (shape.start, shape.end)]
    return []


def box_corners(box: Box) -> list[Vector]:
    """Return the eight corners of a box in its body's frame [m]."""
    R = rotation.matrix(ca.SX(ca.vertcat(*box.quaternion)))
    signs = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    half_size, centre = (ca.SX(ca.vertcat(*value)) for value in (box.half_size, box.centre))
    corners = [ca.vertsplit(centre + R @ (half_size * ca.DM(sign))) for sign in signs]
    return [(x, y, z) for x, y, z in corners]


def _on_segment(capsule: Capsule, pose: SpatialPose, point: ca.SX) -> ca.SX:
    start, end = pose.to_world(capsule.start), pose.to_world(capsule.end)
    segment = end - start
    share = ca.dot(point - start, segment) / ca.sumsqr(segment)
    return start + ca.fmin(ca.fmax(share, 0), 1) * segment


def _nearest_on_segments(
    capsule_a: Capsule, pose_a: SpatialPose, capsule_b: Capsule, pose_b: SpatialPose
) -> tuple[ca.SX, ca.SX]:
    """Return the nearest points of two segments (Ericson, Real-Time Collision Detection, 2005, sec. 5.1.9)."""
    p, q = pose_a.to_world(capsule_a.start), pose_b.to_world(capsule_b.start)
    d, e = pose_a.to_world(capsule_a.end) - p, pose_b.to_world(capsule_b.end) - q
    dd, ee, de, offset = ca.sumsqr(d), ca.sumsqr(e), ca.dot(d, e), p - q

    def clamp(value: ca.SX) -> ca.SX:
        return ca.fmin(ca.fmax(value, 0), 1)

    determinant = ca.fmax(dd * ee - de**2, 1e-12 * dd * ee)
    s = clamp((de * ca.dot(e, offset) - ee * ca.dot(d, offset)) / determinant)
    t = clamp((de * s + ca.dot(e, offset)) / ee)
    s = clamp((de * t - ca.dot(d, offset)) / dd)
    return p + s * d, q + t * e


def _distance_to_plane(plane: Plane, pose: SpatialPose, point: ca.SX) -> tuple[ca.SX, ca.SX]:
    normal = ca.sparsify(pose.R @ ca.SX(ca.vertcat(*plane.normal)))
    return ca.dot(normal, point - pose.to_world(plane.origin)), normal


def _distance_to_round(shape: Sphere | Capsule, pose: SpatialPose, point: ca.SX) -> tuple[ca.SX, ca.SX]:
    centre = pose.to_world(shape.centre) if isinstance(shape, Sphere) else _on_segment(shape, pose, point)
    offset = point - centre
    distance = ca.norm_2(offset)
    return distance - shape.radius, offset / distance


def _distance_to_box(box: Box, pose: SpatialPose, point: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the signed distance of a point from a box (if inside, from the nearest side), and the outward normal."""
    R = pose.R @ ca.sparsify(rotation.matrix(ca.SX(ca.vertcat(*box.quaternion))))
    local = R.T @ (point - pose.to_world(box.centre))
    side = ca.if_else(local >= 0, 1, -1)
    d = side * local - ca.SX(ca.vertcat(*box.half_size))
    face = ca.vertcat(
        ca.logic_and(d[0] >= d[1], d[0] >= d[2]),
        ca.logic_and(d[1] > d[0], d[1] >= d[2]),
        ca.logic_and(d[2] > d[0], d[2] > d[1]),
    )
    distance, toward = _distance_to_faces(d, face)
    return distance, R @ (side * toward)


def _distance_to_cylinder(cylinder: Cylinder, pose: SpatialPose, point: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the signed distance of a point from a cylinder (if inside, from the nearest side), and the normal."""
    start, end = pose.to_world(cylinder.start), pose.to_world(cylinder.end)
    axis, middle = end - start, (start + end) / 2
    half_length = ca.norm_2(axis) / 2
    axis /= 2 * half_length
    height = ca.dot(point - middle, axis)
    radial = point - middle - height * axis
    # On the axis the radial direction is undefined; the constant avoids a division by zero.
    reach = ca.sqrt(ca.sumsqr(radial) + 1e-24)
    up = ca.if_else(height >= 0, 1, -1)
    d = ca.vertcat(reach - cylinder.radius, up * height - half_length)
    distance, toward = _distance_to_faces(d, ca.vertcat(d[0] >= d[1], d[1] > d[0]))
    return distance, toward[0] * radial / reach + toward[1] * up * axis


def _distance_to_faces(d: ca.SX, face: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return signed distance and normal of a point, given its distances d from perpendicular faces.

    ``face`` is the normal of a point inside.
    """
    outer, outside = ca.fmax(d, 0), ca.mmax(d) > 0
    # Inside the root's argument is 1, as its slope at 0 would be infinite.
    outer_distance = ca.sqrt(ca.if_else(outside, ca.sumsqr(outer), 1))
    return ca.if_else(outside, outer_distance, ca.mmax(d)), ca.if_else(outside, outer / outer_distance, face)


DistanceFunction = Callable[..., tuple[ca.SX, ca.SX]]
_DISTANCE_FUNCTIONS: dict[type, DistanceFunction] = {
    Plane: _distance_to_plane,
    Sphere: _distance_to_round,
    Capsule: _distance_to_round,
    Box: _distance_to_box,
    Cylinder: _distance_to_cylinder,
}
"""Mapping from shape types to functions that return a point's signed distance [m] and the outward unit normal."""
