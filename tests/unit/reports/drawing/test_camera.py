"""The view shows all of a motion that stays in place, and follows one that travels."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from problems.drawing import Circle, Mark, Shape, Wall
from reports.drawing.shapes import Camera, make_cameras

R = 0.1


def rolling(x: np.ndarray, *more: Shape) -> list[list[Shape]]:
    return [[Wall(0, 0, 0, 1), Circle(float(value), R, R), *more] for value in x]


def windows(camera: Camera) -> np.ndarray:
    """Return the limits (n_frames, 2, 2) of the axes: frame, low or high, x or y."""
    axis = Figure().subplots()
    found = []
    for frame in range(len(camera.middle)):
        camera.aim(axis, frame)
        found.append(np.transpose([axis.get_xlim(), axis.get_ylim()]))
    return np.array(found)


def holds(camera: Camera, x: np.ndarray) -> bool:
    low, high = windows(camera)[:, 0], windows(camera)[:, 1]
    ball = np.stack([x, np.full_like(x, R)], axis=1)
    return bool(np.all(ball - R >= low - 1e-12) and np.all(ball + R <= high + 1e-12))


def test_a_motion_that_stays_is_seen_whole_and_still() -> None:
    x = np.linspace(0, 0.3, 30)
    (camera,) = make_cameras([rolling(x)])
    assert holds(camera, x)
    assert np.ptp(windows(camera), axis=0).max() == 0


def test_a_goal_in_the_picture_keeps_the_view_still() -> None:
    x = np.linspace(0, 5, 30)
    (camera,) = make_cameras([rolling(x, Mark(5, 0, "goal"))])
    assert holds(camera, x)
    assert np.ptp(windows(camera), axis=0).max() == 0


def test_the_view_goes_along_with_a_motion_that_travels() -> None:
    x = 5 * np.linspace(0, 1, 60) ** 2
    (camera,) = make_cameras([rolling(x)])
    assert holds(camera, x)
    limits = windows(camera)
    assert limits[-1, 0, 0] > limits[0, 1, 0], "it ends where it did not look at the start"
    assert np.all(np.diff(limits[:, 0, 0]) >= 0), "no step back"
    assert np.ptp(limits[:, :, 1], axis=0).max() == 0, "only along the way"
    width = limits[:, 1] - limits[:, 0]
    assert np.ptp(width, axis=0).max() < 1e-9 and width.max() < 1


def test_a_replay_that_runs_away_does_not_shrink_the_plan() -> None:
    x = np.linspace(0, 0.3, 30)
    plan, replay = make_cameras([rolling(x), rolling(x + np.linspace(0, 1, 30) ** 4 * 1e6)])
    assert holds(plan, x)
    assert max(plan.size) < 3
    np.testing.assert_array_equal(plan.size, replay.size)


def test_the_plan_and_its_replay_share_a_still_window_that_holds_both() -> None:
    x = np.linspace(0, 0.3, 30)
    cameras = make_cameras([rolling(x), rolling(x - 0.2)])
    for camera in cameras:
        assert holds(camera, x) and holds(camera, x - 0.2)


def test_a_point_that_stays_is_seen_in_its_surroundings() -> None:
    (camera,) = make_cameras([[[Mark(2, 3)]] * 4])
    np.testing.assert_allclose(windows(camera)[:, 0], [[1.5, 2.5]] * 4)
    np.testing.assert_allclose(windows(camera)[:, 1], [[2.5, 3.5]] * 4)
