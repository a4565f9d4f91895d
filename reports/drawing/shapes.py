"""Drawing of shapes on matplotlib axes, and cameras that choose the window around shapes."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from itertools import takewhile
from typing import Any, TypeVar

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.transforms import Affine2D

from problems.drawing import Circle, Mark, Outline, Rectangle, Segment, Shape, Spring, Stadium, Wall
from reports.drawing.style import BLUE, FAINT, GREEN, GREY, ORANGE, SKY

_ROLE_COLORS = {"object": BLUE, "actuator": ORANGE, "environment": GREY, "goal": GREEN, "plan": SKY}
"""Mapping from the role of a body to its colour."""
Rgba = tuple[float, float, float, float]
TRANSPARENT = (0.0, 0.0, 0.0, 0.0)
"""Colour of the inside of a path that is not filled, and of an edge that is not drawn."""
_ARC_STEP_RAD = math.pi / 16
"""Angle [rad] between the points of a rounded corner."""
_CAP_ANGLES_RAD = np.linspace(-math.pi / 2, math.pi / 2, 18)
"""Angles [rad] of the points of a capsule's end."""
COIL_COUNT = 6
"""Number of windings of a drawn spring."""
COIL_HALF_WIDTH_M = 0.04
"""Half the width of a winding [m]."""
EDGE_PT = 0.9
"""Width of the line around a body [pt]."""
BAR_PT = {Segment: 1.6, Spring: 0.8}
"""Mapping from kinds of bar to the widths of their lines [pt]."""
MARK_PT = 4.5
"""Diameter of a mark [pt]."""
GOAL_PT = 11.0
"""Width of the cross of a goal [pt]."""
FILLED = 0.25
"""Opacity of a body's inside."""
_REACH = 4.0
"""Length and depth of the drawn part of a half plane, as a multiple of the sum of the view's sides."""


def bounds(shapes: Iterable[Shape]) -> np.ndarray:
    """Return the smallest box around shapes [m]: ((x_low, y_low), (x_high, y_high)), shape (2, 2).

    A half plane counts as the point that defines it; a line drawn on a floor is ignored. Without shapes the
    box is ((inf, inf), (-inf, -inf)).
    """
    points = [point for shape in shapes for point in _corners(shape)]
    if not points:
        return np.array([[np.inf, np.inf], [-np.inf, -np.inf]])
    return np.array([np.min(points, axis=0), np.max(points, axis=0)])


def _corners(shape: Shape) -> list[tuple[float, float]]:
    match shape:
        case Circle(x, y, r):
            return [(x - r, y - r), (x + r, y + r)]
        case Rectangle(x, y, width, height, angle):
            c, s = abs(math.cos(angle)), abs(math.sin(angle))
            a, b = (c * width + s * height) / 2, (s * width + c * height) / 2
            return [(x - a, y - b), (x + a, y + b)]
        case Outline(corners, r):
            return [(x + sign * r, y + sign * r) for x, y in corners for sign in (-1, 1)]
        case Stadium(x1, y1, x2, y2, r):
            low = min(x1, x2) - r, min(y1, y2) - r
            return [low, (max(x1, x2) + r, max(y1, y2) + r)]
        case Segment(shade=shade) if shade:
            return []
        case Segment(x1, y1, x2, y2) | Spring(x1, y1, x2, y2):
            return [(x1, y1), (x2, y2)]
        case Mark(x, y) | Wall(x, y):
            return [(x, y)]


def outline(shape: Shape) -> Path:
    """Return the line around a body or along a bar [m]; raises TypeError for a mark or half plane."""
    match shape:
        case Circle(x, y, radius):
            return Path.circle((x, y), radius)
        case Rectangle():
            radius = min(shape.rounding, shape.width / 2, shape.height / 2)
            half_sides = np.array([shape.width, shape.height]) / 2 - radius
            corners = half_sides * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
            points = _grown(corners, radius) if radius else corners
            transform = Affine2D().rotate(shape.angle).translate(shape.x, shape.y)
            return _closed(transform.transform(points))
        case Outline(corners, radius):
            corner_array = np.array(corners)
            return _closed(_grown(corner_array, radius) if radius else corner_array)
        case Stadium(x1, y1, x2, y2, radius):
            direction = np.array([x2 - x1, y2 - y1])
            if not direction.any():
                return Path.circle((x1, y1), radius)
            angles = math.atan2(direction[1], direction[0]) + _CAP_ANGLES_RAD
            cap = radius * np.column_stack([np.cos(angles), np.sin(angles)])
            return _closed(np.concatenate([np.array([x2, y2]) + cap, np.array([x1, y1]) - cap]))
        case Segment(x1, y1, x2, y2):
            return Path([(x1, y1), (x2, y2)])
        case Spring(x1, y1, x2, y2):
            direction = np.array([x2 - x1, y2 - y1])
            length = float(np.linalg.norm(direction)) or 1.0
            normal = np.array([-direction[1], direction[0]]) / length * COIL_HALF_WIDTH_M
            fractions = np.linspace(0, 1, 2 * COIL_COUNT + 2)
            offsets = np.array([0, *([1, -1] * COIL_COUNT), 0])
            return Path(np.array([x1, y1]) + np.outer(fractions, direction) + np.outer(offsets, normal))
    raise TypeError(f"a {type(shape).__name__} has no outline")


def _closed(points: np.ndarray) -> Path:
    return Path(np.concatenate([points, points[:1]]), closed=True)


def _grown(corners: np.ndarray, radius: float) -> np.ndarray:
    """Return the outline (n, 2) of all points within ``radius`` of a convex polygon, counter-clockwise."""
    edges = np.roll(corners, -1, axis=0) - corners
    leaving = np.arctan2(edges[:, 1], edges[:, 0]) - math.pi / 2
    arriving = np.roll(leaving, 1)
    rounded = []
    for corner, start, arc_angle in zip(corners, arriving, (leaving - arriving) % (2 * math.pi), strict=True):
        angles = start + np.linspace(0, arc_angle, 2 + int(arc_angle / _ARC_STEP_RAD))
        rounded.append(corner + radius * np.column_stack([np.cos(angles), np.sin(angles)]))
    return np.concatenate(rounded)


def half_plane_path(shape: Wall, middle: np.ndarray, reach: float) -> Path:
    """Return the part of a half plane within ``reach`` [m] of the projection of ``middle`` on its edge."""
    normal = np.array([shape.nx, shape.ny])
    direction = np.array([-shape.ny, shape.nx])
    # Centred at the projection of the view's middle, so that the view may move along the edge.
    start = np.array([shape.x, shape.y])
    start = start + ((middle - start) @ direction) * direction
    edge = [start - reach * direction, start + reach * direction]
    return _closed(np.array([*edge, edge[1] - reach * normal, edge[0] - reach * normal]))


def width(shape: Shape) -> float:
    """Return the line width of a shape [pt]; lines on a floor are as thin as the edges of bodies."""
    return EDGE_PT if is_opaque(shape) else BAR_PT.get(type(shape), EDGE_PT)


def color(role: str) -> str:
    """Return the colour of bodies with this role, grey for an unknown role."""
    return _ROLE_COLORS.get(role, GREY)


def is_opaque(shape: Shape) -> bool:
    """Return whether a shape hides what lies behind it."""
    return getattr(shape, "shade", 0.0) > 0


def shape_colors(shape: Shape, strength: float = 1.0) -> tuple[Rgba, Rgba]:
    """Return the colours of a body's inside and edge (equal for a bar); ``strength`` scales the darkness."""
    ink, shade = to_rgba(color(shape.role))[:3], getattr(shape, "shade", 0.0)
    if not is_opaque(shape):
        return (*ink, FILLED * strength), (*ink, strength)
    inside, edge = (_on_paper(ink, strength * dark) for dark in (shade, 1.0))
    return inside, inside if isinstance(shape, Segment) else edge


def _on_paper(ink: Sequence[float], share: float) -> Rgba:
    """Return the opaque colour of a mixture of a colour, with weight ``share``, and white."""
    red, green, blue = (1 + share * (channel - 1) for channel in ink)
    return red, green, blue, 1.0


T = TypeVar("T", bound=Hashable)


def constant_shapes(frames: Sequence[Sequence[T]], hiding: Sequence[bool]) -> list[T]:
    """Return the shapes that are in every frame, which are drawn once below the others.

    ``hiding`` is a mask of the shapes in the first frame that hide others. Such a shape is returned only if all frames
    are equal up to this shape.
    """
    n_leading = len([*takewhile(lambda shapes: len(set(shapes)) == 1, zip(*frames, strict=False))])
    common = set.intersection(*map(set, frames))
    return [
        shape
        for i, (shape, hides) in enumerate(zip(frames[0], hiding, strict=True))
        if shape in common and (i < n_leading or not hides)
    ]


def name_axes(axis: Axes, names: tuple[str, str]) -> None:
    """Label the axes; without names, as in a picture of space, remove their ticks."""
    axis.set(xlabel=names[0], ylabel=names[1])
    if not any(names):
        axis.set(xticks=[], yticks=[])


@dataclass(frozen=True)
class Stroke:
    """A path [m] with its colours, line width [pt], and drawing order."""

    path: Path
    face: Rgba
    edge: Rgba
    width: float
    order: int

    def patch(self) -> PathPatch:
        """Return the stroke as an artist."""
        colors = {"facecolor": self.face, "edgecolor": self.edge}
        return PathPatch(self.path, **colors, linewidth=self.width, zorder=self.order, capstyle="round")


def stroke_of(shape: Shape, middle: np.ndarray, size: np.ndarray, strength: float = 1.0) -> Stroke:
    """Return the stroke of a shape other than a mark, in a view of ``middle`` and ``size`` (2,) [m].

    ``strength`` in (0, 1] scales the darkness.
    """
    face, edge = shape_colors(shape, strength)
    match shape:
        case Wall():
            path = half_plane_path(shape, middle, _REACH * float(size.sum()))
            return Stroke(path, to_rgba(FAINT), to_rgba(GREY), 0.8, 0)
        case Segment() | Spring():
            return Stroke(outline(shape), TRANSPARENT, edge, width(shape), 1 if is_opaque(shape) else 2)
    return Stroke(outline(shape), face, edge, EDGE_PT, 1)


def draw(shape: Shape, axis: Axes, strength: float) -> Artist:
    """Draw one shape and return its artist; ``strength`` in (0, 1] scales the darkness."""
    if isinstance(shape, Mark):
        return _mark(shape, axis, strength)
    limits = np.array([axis.get_xlim(), axis.get_ylim()])
    return axis.add_patch(stroke_of(shape, limits.mean(axis=1), np.ptp(limits, axis=1), strength).patch())


def _mark(shape: Mark, axis: Axes, strength: float) -> Line2D:
    look: dict[str, Any] = {"marker": "o", "markersize": MARK_PT, "markeredgewidth": 0}
    if shape.role == "goal":
        look = {"marker": "+", "markersize": GOAL_PT, "markeredgewidth": 1.5, "zorder": 4}
    (mark,) = axis.plot([shape.x], [shape.y], color=color(shape.role), alpha=strength, linestyle="none", **look)
    return mark


_VIEW_MARGIN = 0.08
"""Margin around bodies, as a fraction of the longer side of the view."""
_LEAST_ASPECT = 0.2
"""Minimum ratio of the shorter to the longer side of a fixed view."""
_LEAST_FOLLOWED_ASPECT = 0.4
"""Minimum ratio of the shorter to the longer side of a view that follows bodies."""
_TRAVEL_RATIO = 5.0
"""Ratio of a motion's length to its height and to the bodies' size above which the camera follows it."""
FOLLOWED_WINDOW = 2.2
"""Side of a window that follows bodies, in multiples of their size."""
_WIDE_ASPECT = 0.4
"""Ratio of height to width below which motions are drawn one below the other, not side by side."""


@dataclass(frozen=True)
class Camera:
    """Middle (n_frames, 2) and size (2,) of the view [m], one size for all frames."""

    middle: np.ndarray
    size: np.ndarray

    @property
    def is_wide(self) -> bool:
        """Whether several motions are drawn one below the other, not side by side."""
        return bool(self.size[1] / self.size[0] < _WIDE_ASPECT)

    def aim(self, axis: Axes, frame: int) -> None:
        """Set the limits of ``axis`` to the view in a frame."""
        low, high = self.middle[frame] - self.size / 2, self.middle[frame] + self.size / 2
        axis.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def show(axis: Axes, shapes: Iterable[Shape]) -> None:
    """Set the limits of ``axis`` around ``shapes``, so that half planes and forces are clipped to them."""
    middle, size = view_around(bounds(shapes))
    Camera(middle[None], size).aim(axis, 0)


def view_around(box: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return middle and size (2,) of the view of a box (low, high), with a margin and a minimum ratio of sides."""
    low, high = box
    size = high - low
    # A fixed point has no size: show one metre.
    size = size + 2 * _VIEW_MARGIN * float(size.max()) if size.max() > 0 else np.ones(2)
    return (low + high) / 2, np.maximum(size, _LEAST_ASPECT * size.max())


def make_cameras(plays: Sequence[Sequence[list[Shape]]]) -> list[Camera]:
    """Return a camera for each of several motions, from the shapes in each frame.

    All cameras show the same window. It contains the whole first motion and is extended to contain the others, on
    each side by at most the longer side of the first motion. If this window is over five times as long as its height
    and as the bodies, each camera follows its own motion instead.
    """
    boxes = [
        np.array([bounds(shape for shape in shapes if not isinstance(shape, Wall)) for shapes in play])
        for play in plays
    ]
    union = _union(boxes)
    size = union[1] - union[0]
    body = float(np.max(boxes[0][:, 1] - boxes[0][:, 0]))
    travels = size > _TRAVEL_RATIO * np.maximum(body, size[::-1])
    middle, size = view_around(union)
    if not travels.any():
        return [Camera(np.tile(middle, (len(own_boxes), 1)), size) for own_boxes in boxes]
    size = np.where(travels, FOLLOWED_WINDOW * body, union[1] - union[0] + 2 * _VIEW_MARGIN * FOLLOWED_WINDOW * body)
    size = np.maximum(size, _LEAST_FOLLOWED_ASPECT * size.max())
    return [Camera(np.where(travels, _follow(own_boxes, size), middle), size) for own_boxes in boxes]


def _union(boxes: list[np.ndarray]) -> np.ndarray:
    first = np.array([boxes[0][:, 0].min(axis=0), boxes[0][:, 1].max(axis=0)])
    reach = float(np.max(first[1] - first[0]))
    other_boxes = np.concatenate(boxes)
    low = np.maximum(other_boxes[:, 0].min(axis=0), first[0] - reach)
    high = np.minimum(other_boxes[:, 1].max(axis=0), first[1] + reach)
    return np.array([np.minimum(low, first[0]), np.maximum(high, first[1])])


def _follow(boxes: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return middles (n_frames, 2) of views that follow the bodies smoothly and contain them."""
    middle = boxes.mean(axis=1)
    width = max(1, len(middle) // 8)
    padded = np.pad(middle, ((width, width), (0, 0)), mode="edge")
    weights = np.ones(2 * width + 1) / (2 * width + 1)
    even = np.stack([np.convolve(column, weights, mode="valid") for column in padded.T], axis=1)
    room = np.maximum(size / 2 - (boxes[:, 1] - boxes[:, 0]) / 2, 0)
    return np.clip(even, middle - room, middle + room)
