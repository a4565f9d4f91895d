"""Write an animation to a GIF, an MP4 or a page of HTML that needs nothing else."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, HTMLWriter, PillowWriter

from ocp.errors import InputError
from ocp.store import atomic
from reports.animation import Animation

FORMATS = (".gif", ".mp4", ".html")
DPI = 100
_REST = 0.6
_ICONS = {
    "minus": "−", "plus": "+", "fast-backward": "⏮", "step-backward": "◂", "play": "▶",
    "pause": "❚❚", "step-forward": "▸", "fast-forward": "⏭",
}  # fmt: skip


def check_format(file: Path) -> None:
    """Raise InputError for a name whose ending is unknown, and for an MP4 without ffmpeg."""
    if file.suffix not in FORMATS:
        raise InputError(
            f"an animation ends in {', '.join(FORMATS[:-1])} or {FORMATS[-1]}, not in"
            f" {file.suffix!r}; name it {file.with_suffix('.gif').name}, say"
        )
    if file.suffix == ".mp4" and not FFMpegWriter.isAvailable():
        raise InputError(
            f"{file.name} needs the program ffmpeg, which is not found here; install it, or name"
            f" {file.with_suffix('.gif').name} or {file.with_suffix('.html').name} instead"
        )


def playable(fps: int, file: Path) -> int:
    """Nearest rate [frames/s] that the format keeps: a GIF counts in hundredths of a second."""
    whole = [rate for rate in range(1, 51) if 100 % rate == 0]
    return min(whole, key=lambda rate: abs(rate - fps)) if file.suffix == ".gif" else fps


def write(animation: Animation, file: Path, told: Callable[[int], None] = lambda _: None) -> None:
    """Draw every frame into ``file``, which is there whole or not at all.

    ``told`` is called with the number of frames done. A GIF, which starts over by itself, rests on
    its last frame for a moment.

    Raises :class:`~ocp.errors.InputError` as :func:`check_format` does.
    """
    check_format(file)
    with atomic.replacing(file) as draft:
        with mpl.rc_context():
            # No frame may be left out of a page.
            mpl.rcParams["animation.embed_limit"] = 1000
            _record(animation, draft, told)
        if file.suffix == ".html":
            draft.write_text(_self_contained(draft.read_text(), file.stem))


def _record(animation: Animation, draft: Path, told: Callable[[int], None]) -> None:
    writer = _writer(animation.fps, draft.suffix)
    rest = round(_REST * animation.fps) if draft.suffix == ".gif" else 0
    with writer.saving(animation.figure, str(draft), DPI):
        for frame in range(len(animation.times)):
            animation.draw(frame)
            writer.grab_frame()
            told(frame + 1)
        for _ in range(rest):
            writer.grab_frame()


def _writer(fps: int, suffix: str) -> AbstractMovieWriter:
    match suffix:
        case ".gif":
            return PillowWriter(fps=fps)
        case ".mp4":
            return FFMpegWriter(fps=fps, codec="h264", extra_args=["-pix_fmt", "yuv420p"])
        case _:
            return HTMLWriter(fps=fps, embed_frames=True)


def _self_contained(player: str, title: str) -> str:
    """Make matplotlib's player a whole page: nothing from elsewhere, no random names."""
    player = re.sub(r"<link\b[^>]*>", "", player)
    found = re.search(r'id="_anim_img([0-9a-f]{32})"', player)
    if found:
        player = player.replace(found[1], "0")
    icons = "\n".join(
        f'.fa-{name}::before {{ content: "{sign}" }}' for name, sign in _ICONS.items()
    )
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f"<title>{title}</title>\n<style>\n.fa {{ font-style: normal }}\n"
        f".fa-flip-horizontal {{ display: inline-block; transform: scaleX(-1) }}\n{icons}\n"
        f"</style>\n</head>\n<body>\n{player}\n</body>\n</html>\n"
    )
