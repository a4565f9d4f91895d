"""Strokes of a frame: bodies, arrows of forces, and friction cones, drawn in one collection."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.colors import to_rgba
from matplotlib.path import Path as Outline

from problems.drawing import ContactFrame, Mark, Shape
from reports.drawing import shapes
from reports.drawing.shapes import TRANSPARENT, Camera, Stroke, stroke_of
from reports.drawing.strobe import cone_stroke, longest_arrow, visible_forces
from reports.drawing.style import VERMILLION
from reports.motion.animation import Motion

_POINTS_PER_INCH = 72.0
"""Typographic points per inch."""


HEAD = 5.0, 2.0
"""Length and half the width of an arrow's head [pt]."""


class MotionArtist:
    """Artist of one motion on ``axis`` with its camera; a force of size ``largest`` has the longest arrow."""

    def __init__(self, axis: Axes, motion: Motion, camera: Camera, largest: float, cones: bool) -> None:
        self.axis, self._motion, self._camera = axis, motion, camera
        self._largest, self._cones = largest, cones
        self._strokes = PathCollection([], capstyle="round")
        self._strokes.set_animated(True)
        axis.add_collection(self._strokes, autolim=False)
        camera.aim(axis, 0)
        # Ticks are part of the still background only along axes on which the camera does not move.
        moves = np.ptp(camera.middle, axis=0) > 0
        ticks = zip((axis.xaxis, axis.yaxis), moves, strict=True)
        self._ticks: list[Artist] = [ruler for ruler, moving in ticks if moving]
        for ruler in self._ticks:
            ruler.set_animated(True)

    def draw(self, frame: int) -> None:
        """Draw a frame on the canvas, unless the motion has diverged before this frame."""
        if frame >= len(self._motion.x):
            return
        self.put(frame)
        for artist in (*self._ticks, self._strokes):
            self.axis.draw_artist(artist)

    def put(self, frame: int) -> None:
        """Move camera and paths to a frame."""
        self._camera.aim(self.axis, frame)
        strokes = self.strokes(frame)
        self._strokes.set_paths([stroke.path for stroke in strokes])
        self._strokes.set_facecolor([stroke.face for stroke in strokes])
        self._strokes.set_edgecolor([stroke.edge for stroke in strokes])
        self._strokes.set_linewidth([stroke.width for stroke in strokes])

    def strokes(self, frame: int) -> list[Stroke]:
        """Return the strokes of a frame from back to front."""
        return sorted(self._unsorted_strokes(frame), key=lambda stroke: stroke.order)

    def _unsorted_strokes(self, frame: int) -> Iterator[Stroke]:
        middle, size = self._camera.middle[frame], self._camera.size
        # Size of a typographic point [m], in which line widths and sizes of heads and marks are given.
        figure = self.axis.get_figure(root=True)
        assert figure is not None
        point = size[0] / self.axis.bbox.width * figure.dpi / _POINTS_PER_INCH
        for shape in self._motion.shapes[frame]:
            yield shape_stroke(shape, middle, size, point)
        forces = self._motion.forces
        if forces is None:
            return
        longest, pushes = longest_arrow(size), (forces.normal[frame], forces.friction[frame])
        for pushed in visible_forces(self._motion.contacts[frame], pushes, self._largest):
            if self._cones and pushed[0].friction:
                yield cone_stroke(pushed[0], longest)
            yield arrow_stroke(*pushed, longest / self._largest, point)


def shape_stroke(shape: Shape, middle: np.ndarray, size: np.ndarray, point: float) -> Stroke:
    """Return the stroke of a shape, in a view of ``middle`` and ``size`` [m]; ``point`` is a typographic point [m]."""
    ink = to_rgba(shapes.color(shape.role))
    match shape:
        case Mark(x, y, "goal"):
            arm = shapes.GOAL_PT / 2 * point
            cross = Outline(
                [(x - arm, y), (x + arm, y), (x, y - arm), (x, y + arm)], [Outline.MOVETO, Outline.LINETO] * 2
            )
            return Stroke(cross, TRANSPARENT, ink, 1.5, 4)
        case Mark(x, y):
            return Stroke(Outline.circle((x, y), shapes.MARK_PT / 2 * point), ink, TRANSPARENT, 0.0, 2)
        case _:
            return stroke_of(shape, middle, size)


def arrow_stroke(contact: ContactFrame, normal: float, friction: float, scale: float, point: float) -> Stroke:
    """Return the arrow of a force from its contact; its length is ``scale`` [m per unit] times the force."""
    start, tip = np.array([contact.x, contact.y]), scale * np.array(contact.force(normal, friction))
    length = float(np.hypot(*tip))
    direction, tip = tip / length, start + tip
    head, half_head = (min(size * point, size / HEAD[0] * length) for size in HEAD)
    neck, half_base = tip - head * direction, half_head * np.array([-direction[1], direction[0]])
    ink = to_rgba(VERMILLION)
    corners = [start, neck, neck + half_base, tip, neck - half_base, neck]
    return Stroke(Outline(np.array(corners)), ink, ink, 1.0, 5)
