"""Pictures of an animation: what stays is drawn once, what moves again for every frame."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from reports.camera import Camera
from reports.forces import caption
from reports.motion.animation import Animation
from reports.motion.scene import Scene
from reports.style import GREY, INK, literal

DPI = 100
_WIDTH = 8.0


class Stage:
    """The figure of an animation, and pictures of it: one size, an even number of pixels a side."""

    def __init__(self, animation: Animation) -> None:
        self._animation = animation
        self.figure, axes = _layout(len(animation.motions), animation.cameras[0])
        self._canvas = FigureCanvasAgg(self.figure)
        self.scenes = [
            Scene(axis, motion, camera, animation.largest, animation.cones)
            for axis, motion, camera in zip(axes, animation.motions, animation.cameras, strict=True)
        ]
        self._label()
        self._canvas.draw()
        self._still = self._canvas.copy_from_bbox(self.figure.bbox)

    def _label(self) -> None:
        shown = self._animation
        look = {"fontsize": 11, "color": INK, "va": "top"}
        title = self.figure.suptitle(shown.title, x=0.01, ha="left", **look)
        self.clock = self.figure.text(0.99, 0.98, "", ha="right", animated=True, **look)
        for scene, motion in zip(self.scenes, shown.motions, strict=True):
            scene.axis.set_title(motion.title, loc="left", color=INK)
            scene.axis.set(xlabel=shown.axes[0], ylabel=shown.axes[1])
            scene.axis.label_outer()
        if shown.largest > 0:
            told = caption(shown.largest, shown.unit, shown.rough)
            self.figure.supxlabel(told, x=0.01, ha="left", fontsize=8, color=GREY)
        literal(self.figure).draw_without_rendering()
        # Laid out once: labels that change width from frame to frame must not shake the picture.
        self.figure.set_layout_engine("none")
        self.clock.set_y(title.get_position()[1])

    def picture(self, frame: int) -> np.ndarray:
        """Red, green, blue and opacity of a frame, (height, width, 4) of uint8, and contiguous.

        The next frame is drawn over them.
        """
        self._canvas.restore_region(self._still)
        for scene in self.scenes:
            scene.draw(frame)
        self.clock.set_text(self._animation.clock(frame))
        self.figure.draw_artist(self.clock)
        return np.asarray(self._canvas.buffer_rgba())


def _layout(count: int, camera: Camera) -> tuple[Figure, list[Axes]]:
    """Figure and axes: two motions one above the other where the view is wide, else abreast."""
    ratio = float(camera.size[1] / camera.size[0])
    rows = count if ratio < 0.4 else 1
    columns = count // rows
    width = (_WIDTH - 0.8) / columns - 0.2
    height = rows * float(np.clip(width * ratio, 0.9, 3.6)) + 0.3 * rows + 1.0
    # Films are made of even numbers of pixels.
    figure = Figure(figsize=(_WIDTH, 2 * round(height * DPI / 2) / DPI), dpi=DPI)
    figure.set_layout_engine("constrained", h_pad=0.1)
    return figure, list(figure.subplots(rows, columns, squeeze=False).ravel())
