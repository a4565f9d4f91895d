"""Contacts between shapes in space: distance, normal, point, and the motion they see."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from dynamics.systems.space import rotation
from dynamics.systems.space.body import Vector
from dynamics.systems.space.shapes import Box, Capsule, Cylinder, Hull, Plane, Shape, Sphere

Motions = list[tuple[int, ca.SX, ca.SX, ca.SX]]
"""As :meth:`~dynamics.systems.space.tree.Tree.motions` gives them."""
_FLAT = 1e-3
"""Share of a cylinder's radius by which its rim is rounded where it lies flat on a plane."""
_DOWN = -0.7
"""Where normals point down further than this the tangents are built the other way up."""


class Place(NamedTuple):
    """A shape's frame: rotation (3, 3) into the world, origin (3, 1) [m]."""

    R: ca.SX
    p: ca.SX

    def at(self, point: Vector) -> ca.SX:
        """World position (3, 1) of a point of the frame."""
        return self.p + self.R @ ca.sparsify(ca.SX(ca.vertcat(*point)))


@dataclass(frozen=True, eq=False)
class SpatialContact:
    """How a shape A is near a shape B.

    ``phi`` signed distance [m], negative in penetration; ``normal`` (3, 1) unit vector out of B
    towards A; ``point`` (3, 1) [m] the point of A nearest to B.
    """

    phi: ca.SX
    normal: ca.SX
    point: ca.SX

    @property
    def tangents(self) -> tuple[ca.SX, ca.SX]:
        """Two unit vectors along the surface of B, (1, 0, 0) and (0, 1, 0) on a floor.

        Frisvad's basis, doi 10.1080/2165347X.2012.689606, whose pole is a normal that points down.
        """
        x, y, z = ca.vertsplit(self.normal)
        side = ca.if_else(z > _DOWN, 1, -1)
        a = -1 / (1 + side * z)
        b = x * y * a
        first = ca.vertcat(1 + x * x * a, b, -side * x)
        second = ca.vertcat(side * b, side * (1 + y * y * a), -y)
        return ca.sparsify(first), ca.sparsify(second)

    def rows(self, one: Motions, other: Motions, nv: int) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Rows (1, nv) along the normal and both tangents of the relative velocity at ``point``.

        ``one`` and ``other`` are what moves A and B. A force and its reaction act along one line.
        """
        found = [ca.SX(1, nv) for _ in range(3)]
        for row, along in zip(found, (self.normal, *self.tangents), strict=True):
            for sign, motions in ((1, one), (-1, other)):
                for index, turn, move, pivot in motions:
                    arm = ca.cross(self.point - pivot, along)
                    row[index] += sign * (ca.dot(turn, arm) + ca.dot(move, along))
        return found[0], found[1], found[2]


def between(one: Shape, a: Place, other: Shape, b: Place) -> list[SpatialContact]:
    """The contacts of two shapes: one for each sphere that rounds A, and each corner on a plane.

    Spheres and capsules meet everything but hulls; boxes, cylinders and hulls meet planes by
    corners, a cylinder by the lowest point of either rim. A capsule meets boxes and cylinders by
    its ends. Raises ``ValueError`` for other pairs.
    """
    if isinstance(other, Sphere | Capsule) and not isinstance(one, Sphere):
        one, a, other, b, turned = other, b, one, a, True
    else:
        turned = False
    if isinstance(one, Plane):
        one, a, other, b, turned = other, b, one, a, not turned
    found = _found(one, a, other, b)
    if not found:
        kinds = f"{type(one).__name__} and {type(other).__name__}"
        raise ValueError(f"a contact of {kinds} is not known; take spheres or capsules for one")
    reverse = [SpatialContact(c.phi, -c.normal, c.point - c.phi * c.normal) for c in found]
    return reverse if turned else found


def at_random_poses(rows: ca.SX) -> np.ndarray:
    """Values (m, 3 n) of an expression (m, n) at three random values of all its symbols."""
    symbols = ca.vertcat(ca.SX(0, 1), *ca.symvar(rows))
    evaluate, rng = ca.Function("rows", [symbols], [ca.densify(rows)]), np.random.default_rng(0)
    return np.hstack([evaluate(rng.uniform(0.1, 1, symbols.numel())).full() for _ in range(3)])


def _found(one: Shape, a: Place, other: Shape, b: Place) -> list[SpatialContact]:
    match one, other:
        case _, Plane():
            normal = ca.sparsify(b.R @ ca.SX(ca.vertcat(*other.normal)))
            origin = b.at(other.origin)
            return [
                _contact(ca.dot(normal, centre - origin), normal, centre, radius)
                for centre, radius in _lowest(one, a, normal)
            ]
        case Capsule(), Capsule():
            s, t = _nearest_on_segments(one, a, other, b)
            return [_of_points(s, one.radius, t, other.radius)]
        case Capsule(), Sphere():
            centre = b.at(other.centre)
            return [_of_points(_on_segment(one, a, centre), one.radius, centre, other.radius)]
        case ((Sphere() | Capsule()), _):
            beside = _BESIDE.get(type(other))
            ends = [one.centre] if isinstance(one, Sphere) else [one.start, one.end]
            if beside is None:
                return []
            found = []
            for centre in (a.at(end) for end in ends):
                distance, normal = beside(other, b, centre)
                found.append(_contact(distance, normal, centre, one.radius))
            return found
    return []


def _contact(distance: ca.SX, normal: ca.SX, centre: ca.SX, radius: ca.SX | float) -> SpatialContact:
    """Contact of a sphere whose centre is at ``distance`` from B."""
    return SpatialContact(distance - radius, normal, centre - radius * normal)


def _of_points(one: ca.SX, radius: ca.SX | float, other: ca.SX, more: ca.SX | float) -> SpatialContact:
    """Contacts of spheres around two points."""
    apart = one - other
    distance = ca.norm_2(apart)
    return _contact(distance - more, apart / distance, one, radius)


def _lowest(one: Shape, a: Place, normal: ca.SX) -> list[tuple[ca.SX, ca.SX | float]]:
    """The points of a shape that may touch a plane first, each with the radius around it."""
    match one:
        case Sphere():
            return [(a.at(one.centre), one.radius)]
        case Capsule():
            return [(a.at(end), one.radius) for end in (one.start, one.end)]
        case Box():
            return [(a.at(corner), 0.0) for corner in box_corners(one)]
        case Hull():
            return [(a.at(point), 0.0) for point in one.points]
        case Cylinder():
            axis = a.at(one.end) - a.at(one.start)
            axis /= ca.norm_2(axis)
            out = ca.dot(normal, axis) * axis - normal
            out = one.radius * out / ca.sqrt(ca.sumsqr(out) + _FLAT**2)
            return [(a.at(end) + out, 0.0) for end in (one.start, one.end)]
    return []


def box_corners(box: Box) -> list[Vector]:
    """The eight corners of a box in its body's frame."""
    R = rotation.matrix(ca.SX(ca.vertcat(*box.turn)))
    signs = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    half, centre = (ca.SX(ca.vertcat(*value)) for value in (box.half_size, box.centre))
    corners = [ca.vertsplit(centre + R @ (half * ca.DM(sign))) for sign in signs]
    return [(x, y, z) for x, y, z in corners]


def _on_segment(one: Capsule, a: Place, point: ca.SX) -> ca.SX:
    start, end = a.at(one.start), a.at(one.end)
    along = end - start
    share = ca.dot(point - start, along) / ca.sumsqr(along)
    return start + ca.fmin(ca.fmax(share, 0), 1) * along


def _nearest_on_segments(one: Capsule, a: Place, other: Capsule, b: Place) -> tuple[ca.SX, ca.SX]:
    """Nearest points of two segments (Ericson, Real-Time Collision Detection, 2005, sec. 5.1.9)."""
    p, q = a.at(one.start), b.at(other.start)
    d, e = a.at(one.end) - p, b.at(other.end) - q
    dd, ee, de, off = ca.sumsqr(d), ca.sumsqr(e), ca.dot(d, e), p - q

    def clamped(value: ca.SX) -> ca.SX:
        return ca.fmin(ca.fmax(value, 0), 1)

    across = ca.fmax(dd * ee - de**2, 1e-12 * dd * ee)
    s = clamped((de * ca.dot(e, off) - ee * ca.dot(d, off)) / across)
    t = clamped((de * s + ca.dot(e, off)) / ee)
    s = clamped((de * t - ca.dot(d, off)) / dd)
    return p + s * d, q + t * e


def _beside_plane(other: Plane, b: Place, point: ca.SX) -> tuple[ca.SX, ca.SX]:
    normal = ca.sparsify(b.R @ ca.SX(ca.vertcat(*other.normal)))
    return ca.dot(normal, point - b.at(other.origin)), normal


def _beside_round(other: Sphere | Capsule, b: Place, point: ca.SX) -> tuple[ca.SX, ca.SX]:
    middle = b.at(other.centre) if isinstance(other, Sphere) else _on_segment(other, b, point)
    apart = point - middle
    distance = ca.norm_2(apart)
    return distance - other.radius, apart / distance


def _beside_box(other: Box, b: Place, point: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Outside the distance from the nearest point of the box, inside from the nearest side."""
    R = b.R @ ca.sparsify(rotation.matrix(ca.SX(ca.vertcat(*other.turn))))
    local = R.T @ (point - b.at(other.centre))
    side = ca.if_else(local >= 0, 1, -1)
    d = side * local - ca.SX(ca.vertcat(*other.half_size))
    out = ca.fmax(d, 0)
    outside = ca.mmax(d) > 0
    # Inside the root's argument is 1, as its slope at 0 would be infinite.
    far = ca.sqrt(ca.if_else(outside, ca.sumsqr(out), 1))
    face = ca.vertcat(
        ca.logic_and(d[0] >= d[1], d[0] >= d[2]),
        ca.logic_and(d[1] > d[0], d[1] >= d[2]),
        ca.logic_and(d[2] > d[0], d[2] > d[1]),
    )
    distance = ca.if_else(outside, far, ca.mmax(d))
    return distance, R @ (side * ca.if_else(outside, out / far, face))


def _beside_cylinder(other: Cylinder, b: Place, point: ca.SX) -> tuple[ca.SX, ca.SX]:
    """As beside a box, in the plane of distance from the axis and height along it."""
    start, end = b.at(other.start), b.at(other.end)
    axis, middle = end - start, (start + end) / 2
    half = ca.norm_2(axis) / 2
    axis /= 2 * half
    height = ca.dot(point - middle, axis)
    across = point - middle - height * axis
    # On the axis itself no direction is the nearest; there the side is no neighbour.
    reach = ca.sqrt(ca.sumsqr(across) + 1e-24)
    up = ca.if_else(height >= 0, 1, -1)
    d = ca.vertcat(reach - other.radius, up * height - half)
    out = ca.fmax(d, 0)
    outside = ca.mmax(d) > 0
    far = ca.sqrt(ca.if_else(outside, ca.sumsqr(out), 1))
    face = ca.vertcat(d[0] >= d[1], d[1] > d[0])
    toward = ca.if_else(outside, out / far, face)
    normal = toward[0] * across / reach + toward[1] * up * axis
    return ca.if_else(outside, far, ca.mmax(d)), normal


Beside = Callable[..., tuple[ca.SX, ca.SX]]
_BESIDE: dict[type, Beside] = {
    Plane: _beside_plane,
    Sphere: _beside_round,
    Capsule: _beside_round,
    Box: _beside_box,
    Cylinder: _beside_cylinder,
}
"""Signed distance of a point from a shape's surface, and the unit normal out there."""
