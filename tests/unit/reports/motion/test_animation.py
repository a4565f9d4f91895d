"""Times and states of an animation's frames, before anything is drawn."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ocp.errors import InputError
from reports.motion.animation import Animation, check_drawable, frame_times
from tests.unit.reports.made import sliding_box

N = 4
NORMAL = np.array([[1.0, 2.0], [0.0, 0.0], [4.0, 1.0], [1.0, 1.0]])
VIEW = sliding_box(NORMAL, 0.4 * NORMAL)


def test_frames_play_in_real_time() -> None:
    times = frame_times(2.0, 25, 1.0)
    assert len(times) == 51
    np.testing.assert_allclose(np.diff(times), 1 / 25)
    np.testing.assert_allclose(np.diff(frame_times(2.0, 25, 0.25)), 1 / 100)
    uneven = frame_times(0.33, 10, 1.0)
    assert (uneven[0], uneven[-1]) == (0, 0.33) and len(uneven) == 4


def test_too_many_frames_are_refused_before_any_is_drawn() -> None:
    with pytest.raises(InputError, match=r"25000 frames, at most 1500 are allowed; raise --speed"):
        frame_times(1.0, 25, 0.001)


def test_a_frame_at_a_node_has_the_stored_state_and_one_between_lies_between() -> None:
    x = np.array([0.0, 0.1, 0.4, 0.2, 0.5])
    plan, replay = Animation(sliding_box(NORMAL, NORMAL, x=x, x_replay=-x), fps=20).motions
    np.testing.assert_allclose(plan.x[::2, 0], x, atol=1e-15)
    np.testing.assert_allclose(plan.x[1::2, 0], (x[1:] + x[:-1]) / 2)
    np.testing.assert_allclose(replay.x, -plan.x)
    assert [shapes[1].x for shapes in plan.shapes] == pytest.approx(plan.x[:, 0])


def test_titles_and_the_clock_say_what_is_seen() -> None:
    animation = Animation(VIEW, fps=5, speed=0.5)
    plan, replay = animation.motions
    assert plan.title == "planned under the barrier law"
    assert replay.title == "replayed under the exact law"
    assert animation.clock(0) == "t = 0.00 s   0.5 × real time"
    assert len(animation.times) == 5
    assert Animation(VIEW).clock(-1) == "t = 0.40 s"


def test_a_replay_that_is_the_same_is_not_shown_twice() -> None:
    x = np.linspace(0, 0.5, N + 1)
    (motion,) = Animation(sliding_box(NORMAL, NORMAL, x=x, x_replay=x + 1e-9), fps=10).motions
    assert "replay under the exact law agrees (states within 1e-09)" in motion.title


def test_a_replay_that_runs_away_is_known_as_far_as_it_is_finite() -> None:
    x = np.linspace(0, 0.5, N + 1)
    again = np.where(x > 0.3, np.inf, x + 0.1)
    plan, replay = Animation(sliding_box(NORMAL, NORMAL, x=x, x_replay=again), fps=10).motions
    assert replay.title.endswith("diverges at 0.30 s")
    assert len(plan.x) == 5 and len(replay.x) == len(replay.shapes) == 3


@pytest.mark.parametrize("h", [0.1, 0.01])
def test_forces_belong_to_the_nearest_node_or_to_all_steps_of_a_frame(h: float) -> None:
    normal = np.arange(1.0, 81.0).reshape(40, 2)
    animation = Animation(sliding_box(normal, 0 * normal, h=h), fps=10 if h == 0.1 else 20)
    found = animation.motions[0].forces
    assert found is not None
    assert not found.normal[0].any(), "no step has led to the start"
    expected = normal if h == 0.1 else normal.reshape(8, 5, 2).mean(axis=1)
    np.testing.assert_allclose(found.normal[1:], expected)


def test_a_problem_that_no_name_finds_needs_its_file() -> None:
    with pytest.raises(InputError, match="a run never loads code on its own; name the file"):
        check_drawable(replace(VIEW, spec=None))
