"""Convex polygons, and bodies that are unions of convex shapes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import InitVar, dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from dynamics.systems.checks import parse_point, require_items, require_not_negative
from dynamics.systems.shapes.planar import Box, Disc, HalfPlane, Point, Pose, Scalar, Shape, as_column

# Fraction of a polygon's size below which lengths and turns count as zero.
_FLAT_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Polygon(Shape):
    """A convex polygon with ``vertices`` (at least three, in order), rounded by ``radius``.

    Vertices are given relative to ``centre`` and stored in the frame of the body. Rounding removes area at the
    corners and does not move the sides, as for :class:`Box`. Numeric vertices may be in either order; symbolic
    vertices must run from the first axis of the plane to the second, counterclockwise in (x, y).

    Raises ``ValueError`` for vertices without area, with crossing sides, or not convex, and for a radius so
    large that a side vanishes.
    """

    vertices: Sequence[Point]
    radius: Scalar = 0.0
    centre: InitVar[Point] = (0.0, 0.0)

    def __post_init__(self, centre: Point) -> None:
        if isinstance(self.vertices, str | ca.SX) or len(self.vertices) < 3:
            raise ValueError(f"Polygon vertices must be at least three points, got {self.vertices!r}")
        parse_point("Polygon centre", centre)
        for i, vertex in enumerate(self.vertices):
            parse_point(f"Polygon vertices[{i}]", vertex)
        moved_vertices = [(v[0] + centre[0], v[1] + centre[1]) for v in self.vertices]
        object.__setattr__(self, "vertices", moved_vertices)
        numbers = [parse_point("Polygon vertex", vertex) for vertex in moved_vertices]
        require_not_negative("Polygon radius", self.radius)
        if any(value is None for vertex in numbers for value in vertex):
            return
        vertex_array = np.array(numbers, dtype=float)
        rounded = ca.SX(self.radius)
        if defect := polygon_defect(vertex_array, float(rounded) if rounded.is_constant() else 0.0):
            raise ValueError(f"Polygon {defect}")
        ring = vertex_array[::-1] if is_clockwise(vertex_array) else vertex_array
        object.__setattr__(self, "vertices", tuple((float(x), float(z)) for x, z in ring))

    @cached_property
    def normals(self) -> list[ca.SX]:
        """Outward unit normal (2, 1) of each side; side i starts at vertex i."""
        ring = [as_column(vertex) for vertex in self.vertices]
        edges = [b - a for a, b in zip(ring, ring[1:] + ring[:1], strict=True)]
        return [ca.vertcat(e[1], -e[0]) / ca.norm_2(e) for e in edges]

    @property
    def corners(self) -> tuple[Point, ...]:
        """Centres of the rounded corners, ``v - r (m + n)/(1 + m'n)`` between normals m, n."""
        return self._corners

    @cached_property
    def _corners(self) -> tuple[Point, ...]:
        n = self.normals
        return tuple(
            as_column(v) - self.radius * (n[i - 1] + n[i]) / (1 + ca.dot(n[i - 1], n[i]))
            for i, v in enumerate(self.vertices)
        )

    def signed_distance(self, point: ca.SX, pose: Pose) -> tuple[ca.SX, ca.SX]:
        """Return ``|p - c| - r`` if a corner c of the core is nearest, else ``max n'(p - c) - r``, and the normal.

        The maximum is over the sides: for p outside it is at the side that faces p, for p inside at the nearest
        side. The distance is once differentiable if p is outside the core or near one side only.
        """
        p, corners, n = pose.to_local(point), list(map(as_column, self.corners)), self.normals
        heights = [ca.dot(m, p - c) for m, c in zip(n, corners, strict=True)]
        distance, normal = heights[0], n[0]
        for height, m in zip(heights[1:], n[1:], strict=True):
            normal = ca.if_else(height > distance, m, normal)
            distance = ca.fmax(distance, height)
        for i, corner in enumerate(corners):
            offset = p - corner
            # The point is past the end of the previous side and before the start of the next side.
            is_past_end = n[i - 1][0] * offset[1] - n[i - 1][1] * offset[0] > 0
            is_before_start = n[i][0] * offset[1] - n[i][1] * offset[0] < 0
            is_nearest = ca.logic_and(is_past_end, is_before_start)
            # Elsewhere the root's argument is 1, as its slope at 0 would be infinite.
            length = ca.sqrt(ca.if_else(is_nearest, ca.sumsqr(offset), 1))
            distance = ca.if_else(is_nearest, length, distance)
            normal = ca.if_else(is_nearest, offset / length, normal)
        return distance - self.radius, pose.rotate(normal)


def box_polygon(box: Box) -> Polygon:
    """Return ``box`` as a polygon."""
    return Polygon(Box(box.half_size, 0.0, box.centre).corners, box.radius)


def polygon_defect(vertices: np.ndarray, radius: float) -> str | None:
    """Return why ``vertices`` (n, 2), rounded by ``radius``, do not form a convex polygon; None if they form one."""
    edges = np.roll(vertices, -1, axis=0) - vertices
    size = float(np.ptp(vertices, axis=0).max())
    if not size or np.linalg.norm(edges, axis=1).min() <= _FLAT_TOLERANCE * size:
        return "has two equal vertices; leave one of them out"
    if np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False)[1] <= _FLAT_TOLERANCE * size:
        return "has no area; give vertices that do not lie on one line"
    if _crosses(vertices):
        return "has sides that cross; give the vertices in their order around the outline"
    previous_edges = np.roll(edges, 1, axis=0)
    turns = (-1 if is_clockwise(vertices) else 1) * _cross(previous_edges, edges) / size**2
    if turns.min() < -_FLAT_TOLERANCE:
        return f"is not convex at vertex {turns.argmin()}; write it as a Union of convex polygons"
    if turns.min() <= _FLAT_TOLERANCE:
        return f"vertex {turns.argmin()} lies on the line of its neighbours; leave it out"
    lengths = np.linalg.norm(edges, axis=1)
    turn_angles = np.arctan2(np.abs(_cross(previous_edges, edges)), (previous_edges * edges).sum(axis=1))
    corner_shares = np.tan(turn_angles / 2)
    largest_radius = float((lengths / (corner_shares + np.roll(corner_shares, -1))).min())
    if radius >= largest_radius:
        return f"has corners rounded by {radius:g} m; expected less than {largest_radius:.6g} m"
    return None


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def is_clockwise(vertices: np.ndarray) -> bool:
    """Return whether ``vertices`` (n, 2) run clockwise in (x, y), from the second axis of the plane to the first."""
    return bool(_cross(vertices, np.roll(vertices, -1, axis=0)).sum() < 0)


def _crosses(vertices: np.ndarray) -> bool:
    """Return whether two sides of a polygon that are not neighbours cross."""
    n, ends = len(vertices), np.roll(vertices, -1, axis=0)
    for i in range(n):
        for j in range(i + 2, n - (i == 0)):
            a, b, c, d = vertices[i], ends[i], vertices[j], ends[j]
            side_product = _cross(b - a, c - a) * _cross(b - a, d - a)
            if side_product < 0 and _cross(d - c, a - c) * _cross(d - c, b - c) < 0:
                return True
    return False


@dataclass(frozen=True, eq=False)
class Union:
    """A body made of convex ``parts`` that may share sides but no area, such as a T or an L.

    Raises ``ValueError`` without parts, and for a part that is unbounded or not a shape.
    """

    parts: Sequence[Shape]

    def __post_init__(self) -> None:
        members = require_items("the parts of a Union", Shape, self.parts)
        if not members or any(isinstance(member, HalfPlane) for member in members):
            raise ValueError(f"a Union needs bounded shapes, got {self.parts!r}")
        polygons = (box_polygon(member) if isinstance(member, Box) else member for member in members)
        object.__setattr__(self, "parts", tuple(polygons))


def convex_parts(shape: Shape | Union) -> tuple[Shape, ...]:
    """Return the convex shapes that ``shape`` consists of."""
    return tuple(shape.parts) if isinstance(shape, Union) else (shape,)


def vertex_pairs(shape_a: Shape | Union, shape_b: Shape | Union) -> list[tuple[Shape, Shape]]:
    """Return the contacts of two bodies that may rotate: each corner of one with each part of the other.

    The distance of two disjoint convex shapes is ``d = max t`` subject to ``t <= phi_i``, phi_i the distance of
    corner i of one core from the other shape. Each constraint is a separate contact, ``lam_i phi_i = mu``: the
    central path of the contact smooths this program, and each ``phi_i`` is once differentiable outside the
    cores. The n impulses of two shapes add up to ``mu sum 1/phi_i``, between ``mu/d`` and ``n mu/d``; shapes
    pressed together by an impulse F stay between ``mu/F`` and ``n mu/F`` apart. All these bounds go to zero
    with mu. Two coincident sides touch at the two ends of their common segment. A disc has one
    contact with each part.

    The minimum of ``phi_i`` is the distance of disjoint or touching shapes, and minus the penetration depth if a
    corner is inside a side. If two sharp corners overlap, it is larger than minus the depth. Shapes that cross
    without a corner inside the other count as disjoint. Two corners at the same point have two impulses.
    """
    pairs = []
    for part_a in convex_parts(shape_a):
        for part_b in convex_parts(shape_b):
            if 1 in (len(part_a.corners), len(part_b.corners)):
                pairs.append((part_a, part_b))
                continue
            pairs += [(Disc(part_a.radius, corner), part_b) for corner in _outer(part_a, shape_a)]
            pairs += [(part_a, Disc(part_b.radius, corner)) for corner in _outer(part_b, shape_b)]
    return pairs


def _outer(shape: Shape, body: Shape | Union) -> list[Point]:
    """Return the corners of the part ``shape`` that are corners of ``body``; the first part has the shared ones."""
    members = convex_parts(body)
    if len(members) == 1 or not isinstance(shape, Polygon):
        return list(shape.corners)
    outer_corners = []
    for corner in shape.corners:
        angles = [_angle(member, corner) for member in members]
        owner = next(member for member, angle in zip(members, angles, strict=True) if angle > 0)
        if sum(angles) < np.pi - 1e-6 and owner is shape:
            outer_corners.append(corner)
    return outer_corners


def _angle(member: Shape, point: Point) -> float:
    """Return the interior angle [rad] of ``member`` at ``point``.

    The angle is 0 for a member that is not a polygon. For a polygon with symbolic sides it is 1e-3 at the
    polygon's corners and 0 elsewhere.
    """
    if not isinstance(member, Polygon):
        return 0.0
    heights_over_sides = [
        ca.dot(m, as_column(point) - as_column(c)) for m, c in zip(member.normals, member.corners, strict=True)
    ]
    if not all(side.is_constant() for side in heights_over_sides):
        return 1e-3 if any(point is corner for corner in member.corners) else 0.0
    heights = np.array([float(side) for side in heights_over_sides])
    size = max(float(ca.norm_inf(as_column(v) - as_column(point))) for v in member.vertices)
    sides_through = np.flatnonzero(np.abs(heights) <= _FLAT_TOLERANCE * size)
    if heights.max() > _FLAT_TOLERANCE * size:
        return 0.0
    if len(sides_through) == 2:
        return float(np.pi - ca.acos(ca.dot(*(member.normals[i] for i in sides_through))))
    return np.pi if len(sides_through) else 2 * np.pi
