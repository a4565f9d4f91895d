"""Shapes on matplotlib axes: one way to draw each kind of :mod:`problems.drawing`."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import singledispatch
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon, Rectangle
from matplotlib.transforms import Affine2D

from problems.drawing import Box, Capsule, Disc, HalfPlane, Mark, Segment, Shape, Spring
from reports.style import BLUE, FAINT, GREEN, GREY, ORANGE

_COLORS = {"object": BLUE, "actuator": ORANGE, "environment": GREY, "goal": GREEN}
_COILS = 6
_ARC = math.pi / 16


def bounds(shapes: Iterable[Shape]) -> np.ndarray:
    """Smallest box around shapes [m]: ((x_low, y_low), (x_high, y_high)), shape (2, 2).

    Of a half plane only the point that it is given by counts; without shapes the box is inside out.
    """
    points = [point for shape in shapes for point in _corners(shape)]
    if not points:
        return np.array([[np.inf, np.inf], [-np.inf, -np.inf]])
    return np.array([np.min(points, axis=0), np.max(points, axis=0)])


def _corners(shape: Shape) -> list[tuple[float, float]]:
    match shape:
        case Disc(x, y, r):
            return [(x - r, y - r), (x + r, y + r)]
        case Box(x, y, width, height, angle):
            c, s = abs(math.cos(angle)), abs(math.sin(angle))
            a, b = (c * width + s * height) / 2, (s * width + c * height) / 2
            return [(x - a, y - b), (x + a, y + b)]
        case Capsule(x1, y1, x2, y2, r):
            low = min(x1, x2) - r, min(y1, y2) - r
            return [low, (max(x1, x2) + r, max(y1, y2) + r)]
        case Segment(x1, y1, x2, y2) | Spring(x1, y1, x2, y2):
            return [(x1, y1), (x2, y2)]
        case Mark(x, y) | HalfPlane(x, y):
            return [(x, y)]


@singledispatch
def draw(shape: Any, axis: Axes, strength: float) -> Artist:
    """Draw one shape and return its artist; ``strength`` in (0, 1] is how dark."""
    raise TypeError(f"no way to draw a {type(shape).__name__}")


def _patch(axis: Axes, patch: Patch, role: str, strength: float) -> Patch:
    color = _COLORS.get(role, GREY)
    patch.set(facecolor=(color, 0.25 * strength), edgecolor=(color, strength), linewidth=0.9)
    return axis.add_patch(patch)


def _line(axis: Axes, points: Any, role: str, strength: float, width: float) -> Line2D:
    x, y = np.transpose(points)
    (line,) = axis.plot(x, y, color=_COLORS.get(role, GREY), alpha=strength, linewidth=width,
                        solid_capstyle="round")  # fmt: skip
    return line


@draw.register
def _(shape: Disc, axis: Axes, strength: float) -> Artist:
    return _patch(axis, Circle((shape.x, shape.y), shape.radius), shape.role, strength)


@draw.register
def _(shape: Box, axis: Axes, strength: float) -> Artist:
    radius = min(shape.rounding, shape.width / 2, shape.height / 2)
    inner = Rectangle((radius - shape.width / 2, radius - shape.height / 2),
                      shape.width - 2 * radius, shape.height - 2 * radius)  # fmt: skip
    box = Polygon(_grown(inner.get_corners(), radius)) if radius else inner
    box = _patch(axis, box, shape.role, strength)
    box.set_transform(Affine2D().rotate(shape.angle).translate(shape.x, shape.y) + axis.transData)
    return box


@draw.register
def _(shape: Capsule, axis: Axes, strength: float) -> Artist:
    ends = np.array([(shape.x1, shape.y1), (shape.x2, shape.y2)])
    if np.array_equal(*ends):
        return _patch(axis, Circle(tuple(ends[0]), shape.radius), shape.role, strength)
    return _patch(axis, Polygon(_grown(ends, shape.radius)), shape.role, strength)


def _grown(corners: np.ndarray, radius: float) -> np.ndarray:
    """Outline of everything within ``radius`` of a convex polygon, counter-clockwise, (n, 2)."""
    along = np.roll(corners, -1, axis=0) - corners
    leaving = np.arctan2(along[:, 1], along[:, 0]) - math.pi / 2
    arriving = np.roll(leaving, 1)
    outline = []
    for corner, start, turn in zip(
        corners, arriving, (leaving - arriving) % (2 * math.pi), strict=True
    ):
        angles = start + np.linspace(0, turn, 2 + int(turn / _ARC))
        outline.append(corner + radius * np.column_stack([np.cos(angles), np.sin(angles)]))
    return np.concatenate(outline)


@draw.register
def _(shape: Segment, axis: Axes, strength: float) -> Artist:
    ends = [(shape.x1, shape.y1), (shape.x2, shape.y2)]
    return _line(axis, ends, shape.role, strength, 1.6)


@draw.register
def _(shape: Spring, axis: Axes, strength: float) -> Artist:
    along = np.array([shape.x2 - shape.x1, shape.y2 - shape.y1])
    length = float(np.linalg.norm(along)) or 1.0
    across = np.array([-along[1], along[0]]) / length * 0.04
    place = np.linspace(0, 1, 2 * _COILS + 2)
    side = np.array([0, *([1, -1] * _COILS), 0])
    points = np.array([shape.x1, shape.y1]) + np.outer(place, along) + np.outer(side, across)
    return _line(axis, points, shape.role, strength, 0.8)


@draw.register
def _(shape: Mark, axis: Axes, strength: float) -> Artist:
    mark = _line(axis, [(shape.x, shape.y)], shape.role, strength, 0)
    mark.set(marker="o", markersize=4.5, markeredgewidth=0, linestyle="none")
    if shape.role == "goal":
        mark.set(marker="+", markersize=11, markeredgewidth=1.5, zorder=4)
    return mark


@draw.register
def _(shape: HalfPlane, axis: Axes, strength: float) -> Artist:
    normal = np.array([shape.nx, shape.ny])
    along = np.array([-shape.ny, shape.nx])
    # From where the view's middle meets the edge, so that a view may wander along it.
    middle = np.array([np.mean(axis.get_xlim()), np.mean(axis.get_ylim())])
    start = np.array([shape.x, shape.y])
    start = start + ((middle - start) @ along) * along
    reach = 4 * (np.ptp(axis.get_xlim()) + np.ptp(axis.get_ylim()))
    edge = [start - reach * along, start + reach * along]
    patch = Polygon([*edge, edge[1] - reach * normal, edge[0] - reach * normal],
                    facecolor=FAINT, edgecolor=GREY, linewidth=0.8, zorder=0)  # fmt: skip
    return axis.add_patch(patch)
