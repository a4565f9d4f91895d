"""Projection of solids in space to plane shapes, as seen by a camera, from the farthest to the nearest."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from dynamics.systems.space import shapes
from dynamics.systems.space.rotation import matrix
from problems.drawing import Circle, ContactFrame, Outline, Segment, Shape, Stadium

Array = np.ndarray
Point3 = tuple[float, float, float]
Solid = tuple[shapes.Shape, Array, Array, str]
"""A shape, rotation (3, 3) and position (3,) [m] of its body in the world, and its role."""
EYE_DISTANCE = 4.0
"""Distance of a camera from its target, in sizes of the scene."""
NEAREST_DEPTH = 0.25
"""Depth below which the scale of the picture is constant, in distances from eye to target."""
OVERLAP = 2e-3
"""Overlap up to which two bodies count as separate, in distances from eye to target."""
HALF_FLOOR = 0.7
"""Half the side of the visible floor, in distances from eye to target."""
FLOOR_SHIFT = 0.3
"""Distance by which the middle of a floor is moved from the target, away from the eye, in eye distances."""
LIGHT = np.array([-0.5, 0.75, -0.45])
"""Direction to the light in axes of the camera: from the upper left."""
DARK_FACE = 0.65
"""Shade of a face that is turned away from the light."""
BRIGHT_FACE = 0.12
"""Shade of a face turned to the light."""
ROUND_SHADE = 0.35
"""Shade of round bodies."""
LINE_SHADE = 0.4
"""Shade of the lines on a floor."""
EQUAL_RADII = 1.15
"""Largest ratio of the radii of a capsule's ends in the picture for which both ends are drawn equal."""
CIRCLE = np.array([(math.cos(k * math.pi / 16), math.sin(k * math.pi / 16)) for k in range(32)])
"""Points (32, 2) around the outline of a round body of radius 1."""
CUBE_CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
"""Corners (8, 3) of a box with half sides of 1."""
CUBE_SIDES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
"""Indices of the corners of each face of a box, counter-clockwise seen from outside."""


@dataclass(frozen=True)
class PinholeCamera:
    """A pinhole camera at ``eye`` that looks at ``target`` [m]; one metre at the target has the length ``focal``."""

    eye: Point3
    target: Point3 = (0.0, 0.0, 0.0)
    focal: float = 1.0

    @classmethod
    def around(
        cls, target: Point3, size: float, azimuth: float = -math.pi / 3, elevation: float = 0.35
    ) -> PinholeCamera:
        """Return a camera that shows ``size`` [m] around ``target``.

        ``azimuth`` [rad] is the angle about z from the x axis to the camera, ``elevation`` [rad] its height.
        """
        (x, y, z), away, horizontal_distance = target, EYE_DISTANCE * size, EYE_DISTANCE * size * math.cos(elevation)
        ahead, aside = horizontal_distance * math.cos(azimuth), horizontal_distance * math.sin(azimuth)
        return cls((x + ahead, y + aside, z + away * math.sin(elevation)), target)

    @cached_property
    def axes(self) -> Array:
        """Unit vectors to the right, up and forward, the rows of (3, 3)."""
        forward = (np.array(self.target) - self.eye) / self.distance
        horizontal = math.hypot(forward[0], forward[1])
        right = np.array([forward[1], -forward[0], 0]) / horizontal if horizontal > 1e-9 else np.eye(3)[0]
        return np.array([right, np.cross(right, forward), forward])

    @property
    def distance(self) -> float:
        """Distance from the eye to the target [m]."""
        return math.dist(self.eye, self.target)

    def scale(self, depth: Array) -> Array:
        """Return the length of a metre at ``depth`` [m] in the picture, constant below :data:`NEAREST_DEPTH`."""
        return self.focal * self.distance / np.maximum(depth, NEAREST_DEPTH * self.distance)

    def project(self, points: Array) -> tuple[Array, Array]:
        """Return positions in the picture (n, 2), ``scale * (right, up)``, and depths (n,) [m] of points (n, 3) [m]."""
        in_camera = (points - np.array(self.eye)) @ self.axes.T
        return in_camera[:, :2] * self.scale(in_camera[:, 2])[:, None], in_camera[:, 2]


@dataclass(frozen=True, eq=False)
class _Body:
    """A solid: all points within ``radius`` of the hull of ``points``.

    Each of its ``faces`` is a tuple of corners (n, 3), outer normal (3,), and whether the face is turned to the eye.
    """

    role: str
    points: Array
    radius: float
    faces: list[tuple[Array, Array, bool]]


def solids_seen(camera: PinholeCamera, solids: Iterable[Solid]) -> list[Shape]:
    """Return drawings of the planes, as grids of lines, followed by drawings of the other solids from back to front."""
    lines, bodies = list[Shape](), list[_Body]()
    for shape, R, p, role in solids:
        if isinstance(shape, shapes.Plane):
            origin, normal = np.array([shape.origin, shape.normal], dtype=float) @ R.T
            lines += _grid(camera, origin + p, normal, role)
            continue
        local_points, radius, sides = _points_and_faces(shape)
        points, faces = local_points @ R.T + p, list[tuple[Array, Array, bool]]()
        for corners in (points[[*side]] for side in sides):
            normal = np.cross(corners[1] - corners[0], corners[2] - corners[1])
            faces_eye = bool((camera.eye - corners[0]) @ normal > 0)
            faces.append((corners, normal / np.linalg.norm(normal), faces_eye))
        bodies.append(_Body(role, points, radius, faces))
    return lines + [outline for body in _from_back(camera, bodies) for outline in _visible_shapes(camera, body)]


def frame_seen(camera: PinholeCamera, point: Array, normal: Array, friction: float) -> ContactFrame:
    """Return the frame of a contact at ``point`` (3,) with unit ``normal`` (3,), as seen by the camera.

    The drawn friction cone widens as its axis turns to the camera; its friction is 0 if the eye is inside it.
    """
    ((x, y),), depth = camera.project(point[None])
    right, up, forward = camera.axes @ normal
    scale, away = camera.scale(depth)[0], forward / depth[0]
    # The drawn half angle: sin(half) = sin(atan(friction)) / sin(angle between normal and line of sight).
    cosine = (point - camera.eye) @ normal / np.linalg.norm(point - camera.eye)
    square = 1 - (1 + friction**2) * float(cosine) ** 2
    drawn_friction = friction / math.sqrt(square) if square > 0 else 0.0
    numbers = map(float, (x, y, scale * right - x * away, scale * up - y * away))
    return ContactFrame(*numbers, friction=drawn_friction, flat=False)


def _points_and_faces(shape: shapes.Shape) -> tuple[Array, float, Sequence[Sequence[int]]]:
    """Return points in the body's frame, the radius around them, and the indices of the points of each face."""
    match shape:
        case shapes.Sphere(radius, centre):
            return np.array([centre], dtype=float), float(radius), []
        case shapes.Capsule(start, end, radius):
            return np.array([start, end], dtype=float), float(radius), []
        case shapes.Cylinder(start, end, radius):
            low, high = np.array([start, end], dtype=float)
            ring = float(radius) * CIRCLE @ _tangents(high - low)
            return np.concatenate([low + ring[::-1], high + ring]), 0.0, [range(32), range(32, 64)]
        case shapes.Box(half, centre, turn):
            R = np.array(ca.evalf(matrix(ca.vertcat(*map(ca.SX, turn)))))
            return np.array(centre, dtype=float) + CUBE_CORNERS * half @ R.T, 0.0, CUBE_SIDES
        case shapes.Hull(points):
            return np.array(points, dtype=float), 0.0, []
    raise TypeError(f"cannot draw a {type(shape).__name__}")


def _tangents(normal: Array) -> Array:
    """Return two unit vectors (2, 3) that form a right-handed frame with ``normal``; for z these are x and y."""
    tangent = np.cross(normal, np.eye(3)[int(abs(normal[0]) > 0.9 * np.linalg.norm(normal))])
    return np.array([np.cross(tangent, normal) / np.linalg.norm(normal), tangent]) / np.linalg.norm(tangent)


def _grid(camera: PinholeCamera, origin: Array, normal: Array, role: str) -> Iterator[Segment]:
    """Yield the visible grid lines of a plane, except lines that are too near to the camera."""
    axes, distance = _tangents(normal), camera.distance
    side = next((each for each in (2.0, 1.0, 0.5, 0.25, 0.1) if each <= distance / 12), 0.05)
    middle = axes @ (camera.target + FLOOR_SHIFT * distance * camera.axes[2] - origin) // side
    n_lines = round(HALF_FLOOR * distance / side)
    for k in range(-n_lines, n_lines + 1):
        for ends in ([(k, -n_lines), (k, n_lines)], [(-n_lines, k), (n_lines, k)]):
            ends_on_image, depth = camera.project(origin + side * (middle + ends) @ axes)
            if depth.min() > NEAREST_DEPTH * distance:
                (x1, y1), (x2, y2) = ends_on_image.tolist()
                yield Segment(x1, y1, x2, y2, role, LINE_SHADE)


def _from_back(camera: PinholeCamera, bodies: list[_Body]) -> Iterator[_Body]:
    """Yield bodies from back to front, by depth; a body in front of a face of another body comes after it."""
    shows = np.zeros((len(bodies), len(bodies)), dtype=bool)
    for i, body in enumerate(bodies):
        for corners, normal, faces_eye in body.faces:
            gaps = [
                float(((body_behind.points - corners[0]) @ normal).min()) - body_behind.radius for body_behind in bodies
            ]
            outside = np.array(gaps) > -OVERLAP * camera.distance
            shows[(i, slice(None)) if faces_eye else (slice(None), i)] |= outside
    first = shows & ~shows.T
    remaining = sorted(range(len(bodies)), key=lambda i: -camera.project(bodies[i].points)[1].mean())
    while remaining:
        deepest = next((i for i in remaining if not first[remaining, i].any()), remaining[0])
        yield bodies[remaining.pop(remaining.index(deepest))]


def _visible_shapes(camera: PinholeCamera, body: _Body) -> Iterator[Shape]:
    """Yield the shapes that draw a body: its outline (except for a box), and the faces turned to the camera."""
    from scipy.spatial import ConvexHull

    image_points, depth = camera.project(body.points)
    radii = body.radius * camera.scale(np.sqrt(np.maximum(depth**2 - body.radius**2, 0)))
    (x1, y1), (x2, y2), r = *image_points[[0, -1]].tolist(), float(radii.mean())
    if len(image_points) == 1:
        yield Circle(x1, y1, r, body.role, ROUND_SHADE)
    elif len(image_points) == 2 and radii.max() <= EQUAL_RADII * radii.min():
        yield Stadium(x1, y1, x2, y2, r, body.role, ROUND_SHADE)
    elif len(body.faces) != len(CUBE_SIDES):
        circle = CIRCLE if body.radius else CIRCLE[:1]
        cloud = (image_points[:, None] + radii[:, None, None] * circle).reshape(-1, 2)
        # The option QJ moves points slightly, so that points on one line have a hull.
        hull = ConvexHull(cloud, qhull_options="QJ").vertices
        yield Outline(tuple(cloud[hull].tolist()), 0.0, body.role, ROUND_SHADE)
    for corners, normal, _ in (face for face in body.faces if face[2]):
        shade = DARK_FACE + (BRIGHT_FACE - DARK_FACE) * (1 + float(LIGHT @ camera.axes @ normal)) / 2
        yield Outline(tuple(camera.project(corners)[0].tolist()), 0.0, body.role, shade)
