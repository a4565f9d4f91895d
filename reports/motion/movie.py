"""Frames of an animation, written to a GIF, an MP4 or a self-contained HTML page."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from ocp.errors import InputError
from ocp.store import atomic
from reports.drawing import shapes
from reports.drawing.shapes import Camera
from reports.drawing.strobe import arrow_caption
from reports.drawing.style import GREY, INK, show_literally
from reports.motion.animation import Animation
from reports.motion.player import player_page
from reports.motion.strokes import MotionArtist

MOVIE_DPI = 100
"""Pixels per inch of a frame."""
_FRAME_WIDTH_IN = 8.0
"""Width of a frame [inch]."""


class Canvas:
    """Figure that draws the frames of an animation, all of one size with an even number of pixels per side."""

    def __init__(self, animation: Animation) -> None:
        self._animation = animation
        self.figure, axes = _layout(len(animation.motions), animation.cameras[0])
        self._canvas = FigureCanvasAgg(self.figure)
        self.scenes = [
            MotionArtist(axis, motion, camera, animation.largest, animation.cones)
            for axis, motion, camera in zip(axes, animation.motions, animation.cameras, strict=True)
        ]
        self._label()
        self._canvas.draw()
        self._still = self._canvas.copy_from_bbox(self.figure.bbox)

    def _label(self) -> None:
        animation = self._animation
        text_style = {"fontsize": 11, "color": INK, "va": "top"}
        title = self.figure.suptitle(animation.title, x=0.01, ha="left", **text_style)
        self.clock = self.figure.text(0.99, 0.98, "", ha="right", animated=True, **text_style)
        for scene, motion in zip(self.scenes, animation.motions, strict=True):
            scene.axis.set_title(motion.title, loc="left", color=INK)
            shapes.name_axes(scene.axis, animation.axes)
            scene.axis.label_outer()
        if animation.largest > 0:
            text = arrow_caption(animation.largest, animation.unit, animation.rough)
            self.figure.supxlabel(text, x=0.01, ha="left", fontsize=8, color=GREY)
        show_literally(self.figure).draw_without_rendering()
        # The layout is computed once, so that labels of changing width do not move the picture.
        self.figure.set_layout_engine("none")
        self.clock.set_y(title.get_position()[1])

    def picture(self, frame: int) -> np.ndarray:
        """Return the RGBA image of a frame, a contiguous array (height, width, 4) of uint8.

        The next call overwrites the image.
        """
        self._canvas.restore_region(self._still)
        for scene in self.scenes:
            scene.draw(frame)
        self.clock.set_text(self._animation.clock(frame))
        self.figure.draw_artist(self.clock)
        return np.asarray(self._canvas.buffer_rgba())


def _layout(count: int, camera: Camera) -> tuple[Figure, list[Axes]]:
    """Return figure and axes: two motions one below the other if the view is wide, else side by side."""
    ratio = float(camera.size[1] / camera.size[0])
    rows = count if camera.is_wide else 1
    columns = count // rows
    width = (_FRAME_WIDTH_IN - 0.8) / columns - 0.2
    height = rows * float(np.clip(width * ratio, 0.9, 3.6)) + 0.3 * rows + 1.0
    # Video encoders need an even number of pixels.
    figure = Figure(figsize=(_FRAME_WIDTH_IN, 2 * round(height * MOVIE_DPI / 2) / MOVIE_DPI), dpi=MOVIE_DPI)
    figure.set_layout_engine("constrained", h_pad=0.1)
    return figure, list(figure.subplots(rows, columns, squeeze=False).ravel())


MOVIE_FORMATS = (".gif", ".mp4", ".html")
"""Suffixes of the files to which an animation can be written."""
FASTEST_GIF = 50
"""Maximum number of frames per second of a GIF, since players change delays below 20 ms to 100 ms."""
_REST = 60
"""Additional time of the last frame of a GIF [1/100 s]."""
_SAMPLED = 12
"""Number of frames from which the palette of a GIF is computed."""
_NEARLY_WHITE = 246
"""Value of a colour channel above which a colour counts as white."""
_ROOM = 1 << 20
"""Free space below which a failure is reported as a full disk [bytes]."""


def check_format(file: Path, fps: int = 25) -> None:
    """Raise InputError for an unknown suffix, an MP4 without ffmpeg, or a GIF with too many frames per second."""
    if file.suffix not in MOVIE_FORMATS:
        raise InputError(
            f"an animation must end in {', '.join(MOVIE_FORMATS[:-1])} or {MOVIE_FORMATS[-1]}, got"
            f" {file.suffix!r}; use {file.with_suffix('.gif').name}, for example"
        )
    if file.suffix == ".mp4" and shutil.which("ffmpeg") is None:
        raise InputError(
            f"{file.name} needs the program ffmpeg, which was not found; install it, or use"
            f" {file.with_suffix('.gif').name} or {file.with_suffix('.html').name} instead"
        )
    if file.suffix == ".gif" and fps > FASTEST_GIF:
        raise InputError(
            f"a GIF has at most {FASTEST_GIF} frames per second, got {fps}; lower --fps, or use"
            f" {file.with_suffix('.mp4').name} or {file.with_suffix('.html').name} instead"
        )


def write_animation(animation: Animation, file: Path, report: Callable[[int], None] = lambda _: None) -> int:
    """Write an animation to ``file``, atomically; return the size of the file in bytes.

    ``report`` is called with the number of finished frames.

    Raises :class:`~ocp.errors.InputError` if :func:`check_format` does, and if ffmpeg fails.
    """
    check_format(file, animation.fps)
    with atomic.replace_file(file) as draft:
        match file.suffix:
            case ".gif":
                _write_gif(animation, draft, report)
            case ".mp4":
                _write_mp4(animation, draft, report)
            case _:
                draft.write_text(player_page(animation), encoding="utf-8")
                report(len(animation.times))
        return draft.stat().st_size


def gif_delays(count: int, fps: int) -> list[int]:
    """Return the delays of ``count`` frames in hundredths of a second, integers with the sum ``count / fps``."""
    ends = np.round(100 * np.arange(count + 1) / fps).astype(int)
    return np.diff(ends).tolist()


def _write_gif(animation: Animation, draft: Path, report: Callable[[int], None]) -> None:
    canvas, count = Canvas(animation), len(animation.times)
    palette = _palette(canvas, count)

    def frames() -> Iterator[Image.Image]:
        for frame in range(count):
            picture = Image.fromarray(canvas.picture(frame)).convert("RGB")
            yield picture.quantize(palette=palette, dither=Image.Dither.NONE)
            report(frame + 1)

    frame_delays = gif_delays(count, animation.fps)
    frame_delays[-1] += _REST
    pictures = frames()
    next(pictures).save(
        draft,
        format="GIF",
        save_all=True,
        append_images=pictures,
        loop=0,
        duration=[10 * delay for delay in frame_delays],
    )


def _palette(canvas: Canvas, count: int) -> Image.Image:
    """Return a palette of at most 256 colours for all frames, from every other line of a few of them.

    Colours are selected by difference and not by frequency, since an arrow has few pixels.
    """
    sampled_frames = np.unique(np.linspace(0, count - 1, _SAMPLED).round().astype(int))
    lines = np.concatenate([canvas.picture(frame)[::2, :, :3].copy() for frame in sampled_frames])
    codes = np.unique(lines.astype(np.int32) @ (1 << 16, 1 << 8, 1))
    colours = np.stack([codes >> 16, codes >> 8 & 255, codes & 255], axis=1).astype(np.uint8)
    palette = Image.fromarray(colours[None]).quantize(method=Image.Quantize.MAXCOVERAGE)
    colors = np.array(palette.getpalette()).reshape(-1, 3)
    # Colours are rounded to the palette, so a nearly white entry could replace the white background.
    colors[(colors > _NEARLY_WHITE).all(axis=1)] = 255
    palette.putpalette(colors.ravel().tolist())
    return palette


def _write_mp4(animation: Animation, draft: Path, report: Callable[[int], None]) -> None:
    canvas, count = Canvas(animation), len(animation.times)
    height, width = canvas.picture(0).shape[:2]
    source = f"-f rawvideo -pix_fmt rgba -video_size {width}x{height} -framerate {animation.fps} -i -"
    target = "-codec:v h264 -preset veryfast -pix_fmt yuv420p -movflags +faststart"
    command = ["ffmpeg", "-y", "-loglevel", "error", *source.split(), *target.split(), str(draft)]
    log = draft.with_name("ffmpeg.log")
    # If ffmpeg ends early, its log and exit code give the reason.
    with (
        suppress(BrokenPipeError),
        log.open("wb") as errors,
        subprocess.Popen(command, stdin=subprocess.PIPE, stderr=errors) as encoder,
    ):
        assert encoder.stdin is not None
        for frame in range(count):
            encoder.stdin.write(canvas.picture(frame).data)
            report(frame + 1)
    if encoder.returncode:
        messages = log.read_text(errors="replace").strip().splitlines()
        if shutil.disk_usage(draft.parent).free < _ROOM:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(draft))
        raise InputError(
            f"ffmpeg failed: {messages[-1] if messages else 'no error message'}; install a"
            " version with an h264 encoder, or use a .gif or .html file"
        )
