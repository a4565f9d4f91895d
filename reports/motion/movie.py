"""Write an animation to a GIF, an MP4 or a page of HTML that needs nothing else."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
from PIL import Image

from ocp.errors import InputError
from ocp.store import atomic
from reports.motion.animation import Animation
from reports.motion.canvas import Canvas
from reports.motion.player import player

FORMATS = (".gif", ".mp4", ".html")
FASTEST_GIF = 50
"""Frames a second of a GIF at most: shorter delays than 20 ms are played as 100 ms."""
_REST = 60
"""Hundredths of a second that a GIF shows its last frame before it repeats."""
_SAMPLED = 12
"""Frames that the palette of a GIF is made from."""
_PALE = 246
_ROOM = 1 << 20
"""Bytes; if fewer are free after a failure, the disk was full."""


def check_format(file: Path, fps: int = 25) -> None:
    """Raise InputError for an unknown ending, an MP4 without ffmpeg, or a GIF too fast."""
    if file.suffix not in FORMATS:
        raise InputError(
            f"an animation must end in {', '.join(FORMATS[:-1])} or {FORMATS[-1]}, got"
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


def write(animation: Animation, file: Path, report: Callable[[int], None] = lambda _: None) -> int:
    """Draw every frame to ``file``, atomically; return its size in bytes.

    ``report`` is called with the number of finished frames.

    Raises :class:`~ocp.errors.InputError` as :func:`check_format` does, and where ffmpeg fails.
    """
    check_format(file, animation.fps)
    with atomic.replacing(file) as draft:
        match file.suffix:
            case ".gif":
                _write_gif(animation, draft, report)
            case ".mp4":
                _write_mp4(animation, draft, report)
            case _:
                draft.write_text(player(animation), encoding="utf-8")
                report(len(animation.times))
        return draft.stat().st_size


def delays(count: int, fps: int) -> list[int]:
    """Hundredths of a second of ``count`` frames: whole numbers that add up to ``count / fps``."""
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

    shown = delays(count, animation.fps)
    shown[-1] += _REST
    pictures = frames()
    next(pictures).save(draft, format="GIF", save_all=True, append_images=pictures, loop=0,
                        duration=[10 * delay for delay in shown])  # fmt: skip


def _palette(canvas: Canvas, count: int) -> Image.Image:
    """At most 256 colours for all frames, from every other line of a few of them.

    Chosen by difference, not by frequency: an arrow has few pixels.
    """
    some = np.unique(np.linspace(0, count - 1, _SAMPLED).round().astype(int))
    lines = np.concatenate([canvas.picture(frame)[::2, :, :3].copy() for frame in some])
    codes = np.unique(lines.astype(np.int32) @ (1 << 16, 1 << 8, 1))
    seen = np.stack([codes >> 16, codes >> 8 & 255, codes & 255], axis=1).astype(np.uint8)
    found = Image.fromarray(seen[None]).quantize(method=Image.Quantize.MAXCOVERAGE)
    colors = np.array(found.getpalette()).reshape(-1, 3)
    # Paper is white, and what is looked up is rounded: nothing else may be nearly white.
    colors[(colors > _PALE).all(axis=1)] = 255
    found.putpalette(colors.ravel().tolist())
    return found


def _write_mp4(animation: Animation, draft: Path, report: Callable[[int], None]) -> None:
    canvas, count = Canvas(animation), len(animation.times)
    height, width = canvas.picture(0).shape[:2]
    command = [
        "ffmpeg", "-y", "-loglevel", "error",
        "-f", "rawvideo", "-pix_fmt", "rgba", "-video_size", f"{width}x{height}",
        "-framerate", str(animation.fps), "-i", "-",
        "-codec:v", "h264", "-preset", "veryfast", "-pix_fmt", "yuv420p",
        "-movflags", "+faststart", str(draft),
    ]  # fmt: skip
    log = draft.with_name("ffmpeg.log")
    # If it ends early, its log and exit code give the reason.
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
