"""Area, centroid and second moment of plane shapes, for bodies of uniform density."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import casadi as ca
import numpy as np

from dynamics.systems.shapes.planar import Box, Capsule, Disc, Point, Shape, as_column
from dynamics.systems.shapes.polygon import Polygon, Union, box_polygon, convex_parts

# Nodes and weights of Gauss quadrature on [-1, 1].
_GAUSS = np.polynomial.legendre.leggauss(16)
# Nodes of Gauss quadrature on [0, 1].
_GAUSS_NODES = (_GAUSS[0] + 1) / 2
# Weights of Gauss quadrature on [0, 1].
_GAUSS_WEIGHTS = _GAUSS[1] / 2


class Area(NamedTuple):
    """Area [m²], first moment (2, 1) [m³] and polar second moment [m⁴] of a shape about the origin.

    The values of a union are the sums of its parts' values.
    """

    area: ca.SX
    first: ca.SX
    second: ca.SX

    @property
    def centre(self) -> ca.SX:
        """The centroid (2, 1) [m]."""
        return self.first / self.area

    @property
    def gyration(self) -> ca.SX:
        """Moment of inertia about the centroid per unit mass [m²]."""
        return self.second / self.area - ca.sumsqr(self.centre)


def shape_area(shape: Shape | Union) -> Area:
    """Return area and moments of a bounded shape: the sum of its core, rectangles at the sides and sectors at corners.

    The areas of a union's shapes are added, so they must not overlap. Raises ``ValueError`` for a
    half-plane.
    """
    pieces = [piece for member in convex_parts(shape) for piece in _pieces(member)]
    if not pieces:
        raise ValueError("a half-plane has no area; give a bounded shape")
    total = pieces[0]
    for piece in pieces[1:]:
        total = Area(*map(ca.plus, total, piece))
    return total


def mean_distance(shape: Shape | Union) -> ca.SX:
    """Mean distance [m] of a shape's points from its centroid: ``int |r| dA / A``.

    By the divergence theorem ``int |r| dA`` is the integral of ``|r| (x dy - y dx) / 3`` along the
    boundary, computed by Gauss quadrature; the integrals of a union's shapes are added.
    """
    total_area, total = shape_area(shape), ca.SX(0)
    for member in convex_parts(shape):
        for curve in _boundary(member, total_area.centre):
            total += curve
    return total / (3 * total_area.area)


class _Side(NamedTuple):
    """A side of a core from a to b (2, 1), its outward ``normal``, and the rounded corner at a.

    At the corner the outward normal turns from ``before`` to ``normal`` by the angle ``turn`` [rad].
    """

    a: ca.SX
    b: ca.SX
    normal: ca.SX
    before: ca.SX
    turn: ca.SX


def _sides(core: list[ca.SX]) -> Iterator[_Side]:
    """Yield the sides of a core with two or more corners, counterclockwise; the segment of a capsule has two sides."""
    ends = core[1:] + core[:1]
    normals = [ca.vertcat(*(e[1], -e[0])) / ca.norm_2(e) for e in map(ca.minus, ends, core)]
    for i, (a, b, n) in enumerate(zip(core, ends, normals, strict=True)):
        m = normals[i - 1]
        yield _Side(a, b, n, m, ca.atan2(m[0] * n[1] - m[1] * n[0], ca.dot(m, n)))


def _boundary(shape: Shape, origin: ca.SX) -> Iterator[ca.SX]:
    """Yield the integrals of ``|r| (x dy - y dx)`` about ``origin`` along sides and rounded corners."""
    core, radius = [as_column(corner) - origin for corner in shape.corners], ca.SX(shape.radius)
    if len(core) == 1:
        for quarter in range(4):
            yield _arc(core[0], radius, ca.SX(quarter * ca.pi / 2), ca.SX(ca.pi / 2))
        return
    for a, b, n, m, corner_angle in _sides(core):
        yield _arc(a, radius, ca.atan2(m[1], m[0]), corner_angle)
        half_side = (b - a) / 2
        for begin in (a + radius * n, a + radius * n + half_side):
            for t, weight in zip(_GAUSS_NODES, _GAUSS_WEIGHTS, strict=True):
                point = begin + t * half_side
                yield weight * ca.norm_2(point) * (point[0] * half_side[1] - point[1] * half_side[0])


def _arc(centre: ca.SX, radius: ca.SX, start: ca.SX, arc_angle: ca.SX) -> ca.SX:
    total = ca.SX(0)
    for t, weight in zip(_GAUSS_NODES, _GAUSS_WEIGHTS, strict=True):
        out = ca.vertcat(ca.cos(start + t * arc_angle), ca.sin(start + t * arc_angle))
        point = centre + radius * out
        total += weight * arc_angle * radius * ca.norm_2(point) * ca.dot(point, out)
    return total


def _pieces(shape: Shape) -> list[Area]:
    core, r = [as_column(corner) for corner in shape.corners], ca.SX(shape.radius)
    if len(core) == 1:
        return [_sector(core[0], r, ca.SX(2 * ca.pi), ca.SX.zeros(2))]
    areas = [_ring(core)] if len(core) > 2 else []
    for a, b, n, m, corner_angle in _sides(core):
        areas.append(_ring([a, a + r * n, b + r * n, b]))
        areas.append(_sector(a, r, corner_angle, ca.vertcat(n[1] - m[1], m[0] - n[0])))
    return areas


def _ring(vertices: list[ca.SX]) -> Area:
    """Return area and moments of a polygon with counterclockwise ``vertices``."""
    total = Area(ca.SX(0), ca.SX.zeros(2), ca.SX(0))
    for a, b in zip(vertices, vertices[1:] + vertices[:1], strict=True):
        cross = a[0] * b[1] - a[1] * b[0]
        second = ca.sumsqr(a) + ca.dot(a, b) + ca.sumsqr(b)
        total = Area(
            total.area + cross / 2,
            total.first + cross * (a + b) / 6,
            total.second + cross * second / 12,
        )
    return total


def _sector(centre: ca.SX, r: ca.SX, angle: ca.SX, direction_integral: ca.SX) -> Area:
    """Return area and moments of a disc's sector; ``direction_integral`` integrates unit vectors over ``angle``."""
    size, first = angle * r**2 / 2, r**3 / 3 * direction_integral
    second = angle * r**4 / 4 + 2 * ca.dot(centre, first) + size * ca.sumsqr(centre)
    return Area(size, size * centre + first, second)


def move_shape(shape: Shape | Union, by: Point) -> Shape | Union:
    """Return ``shape`` translated by a vector in its frame; raise ``ValueError`` for a half-plane."""
    step = as_column(by)

    def move_point(point: Point) -> tuple[ca.SX, ca.SX]:
        moved_point = as_column(point) + step
        return moved_point[0], moved_point[1]

    match shape:
        case Union(members):
            return Union([move_shape(member, by) for member in members])  # type: ignore[misc]
        case Disc(radius, centre):
            return Disc(radius, move_point(centre))
        case Capsule(start, end, radius):
            return Capsule(move_point(start), move_point(end), radius)
        case Polygon(vertices, radius):
            return Polygon([move_point(vertex) for vertex in vertices], radius)
        case Box():
            return move_shape(box_polygon(shape), by)
    raise ValueError(f"a {type(shape).__name__} cannot be moved; give a bounded shape")
