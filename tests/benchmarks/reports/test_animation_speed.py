"""Speed of writing animations: frames over a stored background against matplotlib's savefig writers."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter

from docs.generator.measured import write_table
from docs.generator.readme_pictures import moving
from dynamics.contact import Barrier, ContactLaw, Exact
from ocp import solve, store
from problems import get
from reports.drawing.style import house_style
from reports.drawing.view import RunView
from reports.motion.animation import Animation
from reports.motion.movie import MOVIE_DPI, Canvas, write_animation
from tests.benchmarks.ocp.race import tell

FLOOR, ROUNDS = 5.0, 3
CASES: dict[str, tuple[ContactLaw, str]] = {
    "cart-walls": (Barrier(mu=1e-3), "plan beside replay, a camera that stands"),
    "half-cheetah": (Exact(), "four strides, a camera that goes along"),
}
WRITERS: dict[str, Callable[[int], AbstractMovieWriter]] = {
    "gif": lambda fps: PillowWriter(fps=fps),
    "mp4": lambda fps: FFMpegWriter(fps=fps, codec="h264", extra_args=["-pix_fmt", "yuv420p"]),
}


def by_savefig(animation: Animation, file: Path) -> None:
    """Write the same frames as matplotlib does, with the whole figure drawn anew for each."""
    canvas = Canvas(animation)
    for part in canvas.figure.findobj():
        part.set_animated(False)
    writer = WRITERS[file.suffix[1:]](animation.fps)
    with writer.saving(canvas.figure, str(file), MOVIE_DPI):
        for frame in range(len(animation.times)):
            for scene in canvas.scenes:
                scene.put(frame)
            canvas.clock.set_text(animation.clock(frame))
            writer.grab_frame()


def spent(work: Callable[[Animation, Path], None], animation: Animation, file: Path) -> float:
    """Return processor seconds of this process and of the encoder that it waits for."""
    before = os.times()
    work(animation, file)
    after = os.times()
    return sum(after[:4]) - sum(before[:4])


@pytest.mark.bench
@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="there is no ffmpeg")
def test_files_of_an_animation(tmp_path: Path) -> None:
    """Both ways alternate; the least seconds of each count, with layout but without the solve."""
    rows, missed = [], []
    for name, (law, what) in CASES.items():
        run = store.load(store.save(solve(get(name), contact=law), tmp_path, []).path)
        with house_style():
            animation = moving(RunView.of(run))
            for ending in WRITERS:
                ours, theirs = tmp_path / f"ours.{ending}", tmp_path / f"theirs.{ending}"
                pairs = [
                    (spent(by_savefig, animation, theirs), spent(write_animation, animation, ours))
                    for _ in range(ROUNDS)
                ]
                before, after = map(min, zip(*pairs, strict=True))
                sizes = [f"{file.stat().st_size / 1e3:.0f}" for file in (theirs, ours)]
                rows.append(
                    [
                        f"`{name}`, {what}",
                        ending,
                        len(animation.times),
                        f"{before:.2f}",
                        f"{after:.2f}",
                        f"{before / after:.1f}",
                        *sizes,
                    ]
                )
                missed += [rows[-1]] if before / after < FLOOR else []
    columns = ["motion", "file", "frames", "savefig, s", "here, s", "ratio", "savefig, kB", "here, kB"]
    tell("animations", columns, rows)
    write_table(
        "animations",
        title="Writing an animation, processor seconds, the encoder's included",
        command="pytest -m bench -s tests/benchmarks/reports/test_animation_speed.py",
        columns=columns,
        rows=rows,
        note=f"Least of {ROUNDS} alternating runs, laying the figure out included.",
    )
    assert not missed, missed
