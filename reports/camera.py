"""Which part of the plane a picture shows: all of the motion, or a window that goes along."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from problems.drawing import HalfPlane, Shape
from reports.shapes import bounds

_MARGIN = 0.08
_FLATTEST, _LOWEST = 0.2, 0.4
_TRAVEL = 5.0
_AROUND = 2.2


@dataclass(frozen=True)
class Camera:
    """Middle (n_frames, 2) and size (2,) of the view [m], one size for all frames."""

    middle: np.ndarray
    size: np.ndarray

    def aim(self, axis: Axes, frame: int) -> None:
        """Set the limits of ``axis`` to those of a frame."""
        low, high = self.middle[frame] - self.size / 2, self.middle[frame] + self.size / 2
        axis.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def show(axis: Axes, shapes: Iterable[Shape]) -> None:
    """Fix the limits around ``shapes``, so that half planes and forces can be clipped to them."""
    middle, size = around(bounds(shapes))
    Camera(middle[None], size).aim(axis, 0)


def around(box: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middle and size of the view of a box ((low), (high)): a margin, and neither side too thin."""
    low, high = box
    size = high - low
    # A point that stays has no size of its own: a metre around it is as good as any.
    size = size + 2 * _MARGIN * float(size.max()) if size.max() > 0 else np.ones(2)
    return (low + high) / 2, np.maximum(size, _FLATTEST * size.max())


def film(plays: Sequence[Sequence[list[Shape]]]) -> list[Camera]:
    """One camera for each of several motions, given the shapes of each frame of each.

    All show the same window, which holds all of the first motion, and the others as far as they
    stay within its size of it. Where that would be more than five times as long as it is high, or
    as the bodies are large, every camera goes along with its own motion instead.
    """
    boxes = [np.array([_bodies(shapes) for shapes in play]) for play in plays]
    whole = _union(boxes)
    size = whole[1] - whole[0]
    body = float(np.max(boxes[0][:, 1] - boxes[0][:, 0]))
    travels = size > _TRAVEL * np.maximum(body, size[::-1])
    middle, size = around(whole)
    if not travels.any():
        return [Camera(np.tile(middle, (len(own), 1)), size) for own in boxes]
    size = np.where(travels, _AROUND * body, whole[1] - whole[0] + 2 * _MARGIN * _AROUND * body)
    size = np.maximum(size, _LOWEST * size.max())
    return [Camera(np.where(travels, _follow(own, size), middle), size) for own in boxes]


def _bodies(shapes: Iterable[Shape]) -> np.ndarray:
    return bounds(shape for shape in shapes if not isinstance(shape, HalfPlane))


def _union(boxes: list[np.ndarray]) -> np.ndarray:
    first = np.array([boxes[0][:, 0].min(axis=0), boxes[0][:, 1].max(axis=0)])
    reach = float(np.max(first[1] - first[0]))
    others = np.concatenate(boxes)
    low = np.maximum(others[:, 0].min(axis=0), first[0] - reach)
    high = np.minimum(others[:, 1].max(axis=0), first[1] + reach)
    return np.array([np.minimum(low, first[0]), np.maximum(high, first[1])])


def _follow(boxes: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Middles (n_frames, 2) that go along evenly and keep the bodies in view."""
    middle = boxes.mean(axis=1)
    width = max(1, len(middle) // 8)
    padded = np.pad(middle, ((width, width), (0, 0)), mode="edge")
    weights = np.ones(2 * width + 1) / (2 * width + 1)
    even = np.stack([np.convolve(column, weights, mode="valid") for column in padded.T], axis=1)
    room = np.maximum(size / 2 - (boxes[:, 1] - boxes[:, 0]) / 2, 0)
    return np.clip(even, middle - room, middle + room)
