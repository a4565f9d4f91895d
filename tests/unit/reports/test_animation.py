"""Animations: frames at their times, plan and replay, and files of each format."""

from __future__ import annotations

import base64
import re
from io import BytesIO
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from PIL import Image

from ocp.errors import InputError
from reports.animation import Animation, frame_times
from reports.movie import check_format, playable, write
from tests.unit.reports.made import sliding_box

N = 4
NORMAL = np.array([[1.0, 2.0], [0.0, 0.0], [4.0, 1.0], [1.0, 1.0]])
VIEW = sliding_box(NORMAL, 0.4 * NORMAL)


def box_position(axis: Axes) -> float:
    """Middle of the drawn box [m]; the other polygon is the floor."""
    boxes = [patch for patch in axis.patches if isinstance(patch, Polygon)]
    outline = boxes[-1].get_path().vertices
    turned = (boxes[-1].get_transform() - axis.transData).transform(outline)
    return float((turned[:, 0].min() + turned[:, 0].max()) / 2)


def test_frames_play_in_real_time() -> None:
    times = frame_times(2.0, 25, 1.0)
    assert len(times) == 51
    np.testing.assert_allclose(np.diff(times), 1 / 25)
    np.testing.assert_allclose(np.diff(frame_times(2.0, 25, 0.25)), 1 / 100)
    uneven = frame_times(0.33, 10, 1.0)
    assert (uneven[0], uneven[-1]) == (0, 0.33) and len(uneven) == 4


def test_too_many_frames_are_refused_before_any_is_drawn() -> None:
    with pytest.raises(InputError, match=r"25000 frames, expected at most 1500; raise --speed"):
        frame_times(1.0, 25, 0.001)


def test_bodies_lie_between_their_nodes_and_do_not_pile_up() -> None:
    animation = Animation(VIEW, fps=20)
    plan, replay = animation.figure.axes
    assert len(animation.times) == 9
    for frame, time in enumerate(animation.times):
        animation.draw(frame)
        assert box_position(plan) == pytest.approx(0.5 * time / 0.4)
        assert box_position(replay) == pytest.approx(0.5 * time / 0.4 + 0.1)
        assert len([p for p in plan.patches if isinstance(p, Polygon)]) == 2
    assert animation._clock.get_text() == "t = 0.40 s"


def test_titles_and_axes_say_what_is_seen() -> None:
    animation = Animation(VIEW, fps=5, speed=0.5)
    plan, replay = animation.figure.axes
    assert plan.get_title("left") == "planned under the barrier law"
    assert replay.get_title("left") == "replayed under the exact law"
    assert [replay.get_xlabel(), plan.get_ylabel()] == ["x [m]", "y [m]"]
    animation.draw(0)
    assert animation._clock.get_text() == "t = 0.00 s   0.5 × real time"
    assert len(animation.times) == 5


def test_a_replay_that_is_the_same_is_not_shown_twice() -> None:
    x = np.linspace(0, 0.5, N + 1)
    animation = Animation(sliding_box(NORMAL, NORMAL, x=x, x_replay=x + 1e-9), fps=10)
    (axis,) = animation.figure.axes
    assert "replay under the exact law is the same (states within 1e-09)" in axis.get_title("left")


def test_a_replay_that_runs_away_is_drawn_as_far_as_it_is_known() -> None:
    x = np.linspace(0, 0.5, N + 1)
    again = np.where(x > 0.3, np.inf, x + 0.1)
    animation = Animation(sliding_box(NORMAL, NORMAL, x=x, x_replay=again), fps=10)
    plan, replay = animation.figure.axes
    assert replay.get_title("left").endswith("runs away at 0.30 s")
    animation.draw(2)
    assert replay.patches
    animation.draw(4)
    assert plan.patches and not replay.patches


@pytest.mark.parametrize("h", [0.1, 0.01])
def test_forces_belong_to_the_nearest_node_or_to_all_steps_of_a_frame(h: float) -> None:
    normal = np.arange(1.0, 81.0).reshape(40, 2)
    animation = Animation(sliding_box(normal, 0 * normal, h=h), fps=10 if h == 0.1 else 20)
    found = animation.motions[0].forces
    assert found is not None
    assert not found.normal[0].any(), "no step has led to the start"
    expected = normal if h == 0.1 else normal.reshape(8, 5, 2).mean(axis=1)
    np.testing.assert_allclose(found.normal[1:], expected)


def test_a_gif_has_every_frame_and_they_differ(tmp_path: Path) -> None:
    animation, done = Animation(VIEW, fps=10), []
    write(animation, tmp_path / "box.gif", done.append)
    assert done == [1, 2, 3, 4, 5]
    with Image.open(tmp_path / "box.gif") as movie:
        assert movie.n_frames == len(animation.times)
        pictures = []
        for frame in range(movie.n_frames):
            movie.seek(frame)
            # The last one rests before the movie starts over.
            rest = frame == movie.n_frames - 1
            assert movie.info["duration"] == 100 or (rest and movie.info["duration"] > 500)
            pictures.append(np.asarray(movie.convert("RGB"), dtype=int))
    assert all(np.abs(a - b).max() > 100 for a, b in pairwise(pictures))
    assert [path.name for path in tmp_path.iterdir()] == ["box.gif"]


def test_a_page_has_all_frames_and_asks_nobody_for_anything(tmp_path: Path) -> None:
    for name in ("a.html", "again.html"):
        write(Animation(VIEW, fps=5), tmp_path / name)
    text = (tmp_path / "a.html").read_text()
    assert text.startswith("<!doctype html>")
    shown = re.findall(r'frames\[\d+\] = "data:image/png;base64,([^"]+)"', text)
    assert len(shown) == 3
    for picture in shown:
        content = base64.b64decode(picture.replace("\\\n", ""))
        assert Image.open(BytesIO(content)).size[0] == 800
    without_pictures = re.sub(r'"data:image/png;base64,[^"]+"', "", text)
    assert not re.search(r"https?:|//\w+\.|<link|@import|url\(|src=", without_pictures)
    icons = set(re.findall(r'class="fa fa-([\w-]+)', without_pictures))
    assert icons and all(f".fa-{icon}::before" in without_pictures for icon in icons)
    assert (tmp_path / "again.html").read_text().replace("again", "a") == text


def test_an_animation_that_fails_leaves_nothing(tmp_path: Path) -> None:
    def fail(done: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write(Animation(VIEW, fps=5), tmp_path / "box.gif", fail)
    assert not list(tmp_path.iterdir())


def test_an_mp4_without_ffmpeg_is_refused_with_a_way_out(monkeypatch) -> None:
    monkeypatch.setattr("reports.movie.FFMpegWriter.isAvailable", lambda: False)
    with pytest.raises(InputError, match=r"needs the program ffmpeg.*box\.gif or box\.html"):
        check_format(Path("box.mp4"))
    check_format(Path("box.gif"))
    check_format(Path("box.html"))


@pytest.mark.parametrize(("asked", "given"), [(25, 25), (30, 25), (60, 50), (24, 25), (1, 1)])
def test_a_gif_gets_a_rate_that_it_can_keep(asked: int, given: int) -> None:
    assert playable(asked, Path("a.gif")) == given
    assert playable(asked, Path("a.html")) == asked
