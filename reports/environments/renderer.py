"""Images of a task's state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from problems.drawing import Shape, Wall
from problems.tasks.registry import TaskSpec
from reports.drawing.shapes import FOLLOWED_WINDOW, Camera, bounds, draw, name_axes
from reports.drawing.strobe import draw_motion
from reports.drawing.style import INK, house_style

_IMAGE_SIZE_IN = (6.4, 4.0)
"""Width and height of an image [inch]."""
_IMAGE_DPI = 100
"""Pixels per inch of an image."""
_ROOM_BELOW = 0.1
"""Space below the ground, as a fraction of the height of the window."""


class Renderer:
    """Renderer of images (400, 640, 3), with a camera that follows the bodies."""

    def __init__(self, spec: TaskSpec, params: object) -> None:
        self._spec, self._params = spec, params
        self._size: np.ndarray | None = None

    def of(self, states: Sequence[np.ndarray], time: float) -> np.ndarray:
        """Return an image of a state (nx,) at ``time`` [s], or a strobe of several ``states``."""
        with house_style():
            figure = Figure(_IMAGE_SIZE_IN, _IMAGE_DPI)
            canvas, axis = FigureCanvasAgg(figure), figure.subplots()
            plays = [self._spec.draw(self._params, state) for state in states]
            if len(plays) > 1:
                draw_motion(axis, plays)
            else:
                self._view(plays[0]).aim(axis, 0)
                for shape in plays[0]:
                    draw(shape, axis, 1.0)
            name_axes(axis, self._spec.axes)
            axis.set_title(f"t = {time:.2f} s", loc="right", color=INK)
            canvas.draw()
            return np.array(canvas.buffer_rgba())[:, :, :3].copy()

    def _view(self, shapes: list[Shape]) -> Camera:
        """Return a window that includes the ground; its size depends on the bodies of the first image."""
        bodies = [shape for shape in shapes if not isinstance(shape, Wall)]
        (x_low, y_low), (x_high, y_high) = bounds(bodies)
        if self._size is None:
            window_width = FOLLOWED_WINDOW * max(x_high - x_low, y_high - y_low)
            self._size = np.array([window_width, window_width * _IMAGE_SIZE_IN[1] / _IMAGE_SIZE_IN[0]])
        height = self._size[1]
        floor = min(y_low, bounds(shapes)[0, 1]) - _ROOM_BELOW * height
        # The window moves up with a body that would leave it at the top.
        middle = max(floor + height / 2, y_high - height / 2)
        return Camera(np.array([[(x_low + x_high) / 2, middle]]), self._size)
