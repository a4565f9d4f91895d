"""Movie files of each format: frames, timing, and requests that are rejected before any work."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ocp.errors import InputError
from reports.motion.animation import Animation
from reports.motion.movie import Canvas, check_format, gif_delays, write_animation
from tests.unit.reports.made import sliding_box

NORMAL = np.array([[1.0, 2.0], [0.0, 0.0], [4.0, 1.0], [0.0, 0.0]])
ARROW = np.array([0xD5, 0x5E, 0x00])
VIEW = sliding_box(NORMAL, 0.4 * NORMAL)


@pytest.mark.costly
def test_a_gif_has_every_frame_at_its_time_and_the_colours_drawn(tmp_path: Path) -> None:
    animation, done = Animation(VIEW, fps=10), []
    write_animation(animation, tmp_path / "box.gif", done.append)
    assert done == [1, 2, 3, 4, 5]
    canvas = Canvas(animation)
    with Image.open(tmp_path / "box.gif") as movie:
        assert movie.n_frames == len(animation.times)
        pictures = []
        for frame in range(movie.n_frames):
            movie.seek(frame)
            # The last frame is held before the movie repeats.
            rest = 600 if frame == movie.n_frames - 1 else 0
            assert movie.info["duration"] == 100 + rest
            pictures.append(np.asarray(movie.convert("RGB"), dtype=int))
            drawn = canvas.picture(frame)[..., :3].astype(int)
            assert np.mean(np.abs(pictures[-1] - drawn).max(axis=-1)) < 1
            assert np.all(pictures[-1][(drawn == 255).all(axis=-1)] == 255), "paper is white"
            arrows = np.abs(drawn - ARROW).max(axis=-1) < 12
            assert arrows.sum() > 20 or frame in (0, 2, 4), "no step or no push led there"
            assert np.all(np.abs(pictures[-1][arrows] - ARROW).max(axis=-1) < 30), "few pixels too"
    assert all(np.abs(a - b).max() > 100 for a, b in pairwise(pictures))
    assert [path.name for path in tmp_path.iterdir()] == ["box.gif"]


@pytest.mark.cheap_cases("1")
@pytest.mark.parametrize("fps", [1, 7, 24, 25, 30, 50])
def test_a_gif_keeps_the_rate_that_was_asked(fps: int, tmp_path: Path) -> None:
    """Delays are multiples of 0.01 s; the error of their sum is always below half of that."""
    shown = gif_delays(300, fps)
    assert np.abs(np.cumsum(shown) - 100 * np.arange(1, 301) / fps).max() <= 0.5
    assert max(shown) - min(shown) <= 1 and min(shown) >= 2
    file = tmp_path / "box.gif"
    write_animation(Animation(sliding_box(np.repeat(NORMAL, 3, axis=0), 0 * np.ones((12, 2))), fps=fps), file)
    with Image.open(file) as movie:
        length = sum(movie.seek(k) or movie.info["duration"] for k in range(movie.n_frames))
    assert length == pytest.approx(10 * sum(gif_delays(round(1.2 * fps) + 1, fps)) + 600)


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="there is no ffmpeg")
@pytest.mark.parametrize("fps", [10, 30])
def test_a_film_has_every_frame_at_the_rate_that_was_asked(fps: int, tmp_path: Path) -> None:
    animation, done, file = Animation(VIEW, fps=fps), [], tmp_path / "box.mp4"
    write_animation(animation, file, done.append)
    assert len(done) == len(animation.times) == 0.4 * fps + 1
    asked = ["-count_frames", "-show_entries", "stream=r_frame_rate,nb_read_frames,width,height"]
    told = subprocess.run(
        ["ffprobe", "-v", "error", *asked, "-of", "json", str(file)],
        capture_output=True,
        check=True,
    )
    (stream,) = json.loads(told.stdout)["streams"]
    height, width = Canvas(animation).picture(0).shape[:2]
    assert (stream["height"], stream["width"]) == (height, width)
    assert stream["r_frame_rate"] == f"{fps}/1"
    assert int(stream["nb_read_frames"]) == len(animation.times)
    raw = subprocess.run(
        ["ffmpeg", "-v", "error", "-i", str(file), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"],
        capture_output=True,
        check=True,
    )
    shown = np.frombuffer(raw.stdout, np.uint8).reshape(-1, height, width, 3)
    canvas = Canvas(animation)
    for frame, picture in enumerate(shown):
        away = np.abs(picture.astype(int) - canvas.picture(frame)[..., :3]).max(axis=-1)
        assert np.mean(away) < 3, "compressed with some loss"


def test_an_encoder_that_fails_is_told_in_one_sentence(tmp_path: Path, monkeypatch) -> None:
    broken = tmp_path / "bin" / "ffmpeg"
    broken.parent.mkdir()
    broken.write_text("#!/bin/sh\necho first >&2\necho 'Unknown encoder h264' >&2\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("PATH", str(broken.parent), prepend=os.pathsep)
    with pytest.raises(InputError, match="ffmpeg failed: Unknown encoder h264; install"):
        write_animation(Animation(VIEW, fps=50), tmp_path / "box.mp4")
    assert [path.name for path in tmp_path.iterdir()] == ["bin"]


def test_an_animation_that_fails_leaves_nothing(tmp_path: Path) -> None:
    def fail(done: int) -> None:
        raise KeyboardInterrupt

    for ending in ("gif", "html"):
        with pytest.raises(KeyboardInterrupt):
            write_animation(Animation(VIEW, fps=5), tmp_path / f"box.{ending}", fail)
    assert not list(tmp_path.iterdir())


def test_an_mp4_without_ffmpeg_is_refused_with_a_way_out(monkeypatch) -> None:
    monkeypatch.setattr("reports.motion.movie.shutil.which", lambda name: None)
    with pytest.raises(InputError, match=r"needs the program ffmpeg.*box\.gif or box\.html"):
        check_format(Path("box.mp4"))
    check_format(Path("box.gif"))
    check_format(Path("box.html"))


def test_a_gif_faster_than_browsers_show_is_refused() -> None:
    with pytest.raises(InputError, match=r"at most 50 frames per second, got 60; lower --fps"):
        check_format(Path("box.gif"), 60)
    check_format(Path("box.gif"), 50)
    check_format(Path("box.html"), 60)
