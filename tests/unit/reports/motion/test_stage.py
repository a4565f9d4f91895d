"""Pictures: bodies at their states, forces to scale, and frames equal to pictures drawn from scratch."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.path import Path

from problems.drawing import Circle, Mark, Segment, Spring, Wall
from reports.drawing.shapes import Stroke
from reports.drawing.style import FAINT, PURPLE, VERMILLION
from reports.motion.animation import Animation
from reports.motion.movie import Canvas
from reports.motion.strokes import HEAD, MotionArtist, shape_stroke
from tests.unit.reports.made import FRICTION, sliding_box

NORMAL = np.array([[1.0, 2.0], [0.5, 0.0], [4.0, 1.0], [1.0, 1.0]])
SLIP = np.array([[-0.5, 1.0], [0.1, 0.0], [-1.0, 0.0], [0.2, 0.3]])
VIEW = sliding_box(NORMAL, SLIP)


def colored(scene: MotionArtist, frame: int, color: str) -> list[Path]:
    """Return the paths of a frame whose face or edge has a colour."""
    rgb = to_rgba(color)[:3]
    return [s.path for s in scene.strokes(frame) if rgb in (s.face[:3], s.edge[:3])]


def arrows(scene: MotionArtist, frame: int) -> np.ndarray:
    """Return the vectors [m] of a frame's arrows from tail to tip, (n, 2)."""
    return np.array([path.vertices[3] - path.vertices[0] for path in colored(scene, frame, VERMILLION)])


def test_bodies_lie_where_states_say_and_nothing_piles_up() -> None:
    animation = Animation(VIEW, fps=20)
    plan, replay = Canvas(animation).scenes
    assert len(animation.times) == 9
    for frame, time in enumerate(animation.times):
        for scene, ahead in ((plan, 0.0), (replay, 0.1)):
            ground, box, *forces = scene.strokes(frame)
            assert ground.face == to_rgba(FAINT)
            ends = box.path.vertices[:, 0]
            assert (ends.min() + ends.max()) / 2 == pytest.approx(0.5 * time / 0.4 + ahead)
            assert len(forces) == len(colored(scene, frame, VERMILLION))


@pytest.mark.costly
def test_the_longest_arrow_is_the_largest_force_and_the_replay_is_to_the_same_scale() -> None:
    """The replay's forces are half of the plan's, and so are its arrows in every frame."""
    plan, replay = Canvas(Animation(VIEW, fps=10)).scenes
    found = []
    for frame in range(1, 5):
        ours = arrows(plan, frame)
        np.testing.assert_allclose(arrows(replay, frame), ours / 2, rtol=1e-9, atol=1e-15)
        found += list(ours)
    expected = np.stack([SLIP, NORMAL], axis=-1).reshape(-1, 2)
    expected = expected[np.hypot(*expected.T) > 0]
    scale = np.hypot(*np.transpose(found)).max() / np.hypot(*expected.T).max()
    np.testing.assert_allclose(found, scale * expected, rtol=1e-9, atol=1e-15)


@pytest.mark.costly
def test_cones_are_drawn_on_request_and_hold_the_forces_at_their_edge() -> None:
    assert not colored(Canvas(Animation(VIEW, fps=10)).scenes[0], 1, PURPLE)
    scene = Canvas(Animation(VIEW, fps=10, cones=True)).scenes[0]
    heel, toe = colored(scene, 1, PURPLE)
    x = 0.5 / 4
    for cone, foot in ((heel, x - 0.15), (toe, x + 0.15)):
        for share, inside in ((0.99, True), (1.01, False)):
            point = np.array([foot, 0]) + 0.02 * np.array([share * FRICTION, 1])
            assert cone.contains_point(point) is inside


@pytest.mark.costly
def test_a_picture_is_what_drawing_everything_anew_gives() -> None:
    """Frames drawn one after the other have the same pixels as a figure drawn once."""
    kept = Canvas(Animation(VIEW, fps=10))
    pictures = [kept.picture(frame).copy() for frame in range(5)]
    for frame in (4, 1):
        fresh = Canvas(Animation(VIEW, fps=10))
        np.testing.assert_array_equal(fresh.picture(frame), pictures[frame])
    whole = Canvas(Animation(VIEW, fps=10))
    whole.picture(3)
    for part in whole.figure.findobj():
        part.set_animated(False)
    canvas = FigureCanvasAgg(whole.figure)
    canvas.draw()
    at_once = np.asarray(canvas.buffer_rgba()).astype(int)
    # A figure drawn at once has grid lines and spines over the ground, an animation under it.
    assert np.mean(np.abs(at_once - pictures[3]).max(axis=-1) > 40) < 0.01


def test_a_body_colours_the_pixels_that_it_covers() -> None:
    canvas = Canvas(Animation(VIEW, fps=10))
    height = canvas.picture(0).shape[0]
    axis = canvas.scenes[0].axis
    column, row = axis.transData.transform((0.5, 0.1)).round().astype(int)
    before = canvas.picture(0)[height - row, column].tolist()
    after = canvas.picture(4)[height - row, column].tolist()
    assert before[2] - before[0] == 0 and after[2] - after[0] > 30, (before, after)
    assert canvas.picture(0).shape[0] % 2 == canvas.picture(0).shape[1] % 2 == 0


def test_a_motion_that_has_run_away_leaves_its_axes_empty() -> None:
    x = np.linspace(0, 0.5, 5)
    again = np.where(x > 0.3, np.inf, x + 0.1)
    canvas = Canvas(Animation(sliding_box(NORMAL, SLIP, x=x, x_replay=again), fps=10))
    box = canvas.scenes[1].axis.bbox
    height = canvas.picture(0).shape[0]
    inside = np.s_[height - int(box.y1) + 2 : height - int(box.y0) - 2, int(box.x0) + 2 : int(box.x1)]
    assert canvas.picture(2)[inside].min() < 150
    assert canvas.picture(4)[inside].min() > 200


def test_ticks_go_along_with_a_camera_that_travels() -> None:
    """Away from the start the tick labels have changed."""
    x = np.linspace(0, 8, 5)
    canvas = Canvas(Animation(sliding_box(NORMAL, SLIP, x=x, x_replay=x), fps=10))
    axis, height = canvas.scenes[0].axis, canvas.picture(0).shape[0]
    below = np.s_[height - int(axis.bbox.y0) + 2 : height - int(axis.bbox.y0) + 18]
    labels = []
    for frame in (0, 4):
        labels.append(canvas.picture(frame)[below].copy())
        low, high = axis.get_xlim()
        assert low < x[frame] < high
    assert np.abs(labels[0].astype(int) - labels[1]).max() > 100


VIEWED = np.zeros(2), np.array([2.0, 1.0]), 0.01


@pytest.mark.parametrize(
    ("shape", "low", "high"),
    [
        (Circle(1, 2, 0.5), (0.5, 1.5), (1.5, 2.5)),
        (Segment(0, 0, 1, 2), (0, 0), (1, 2)),
        (Spring(0, 0, 1, 0), (0, -0.04), (1, 0.04)),
        (Mark(0, 0), (-0.0225, -0.0225), (0.0225, 0.0225)),
        (Mark(1, 1, "goal"), (0.945, 0.945), (1.055, 1.055)),
        (Wall(0, 0, 0, 1), (-12, -12), (12, 0)),
    ],
    ids=["disc", "segment", "spring", "mark", "goal", "half plane"],
)
def test_a_stroke_spans_its_shape(shape, low, high) -> None:
    """A point on paper is 1 cm here, so that marks of 4.5 pt and crosses of 11 pt are 4.5 cm and 11 cm wide."""
    stroke: Stroke = shape_stroke(shape, *VIEWED)
    extent = stroke.path.get_extents()
    np.testing.assert_allclose([extent.min, extent.max], [low, high], atol=1e-9)


def test_the_head_of_a_short_arrow_is_no_longer_than_the_arrow() -> None:
    scene = Canvas(Animation(VIEW, fps=10)).scenes[0]
    for path in colored(scene, 3, VERMILLION) + colored(scene, 2, VERMILLION):
        start, neck, _, tip = path.vertices[:4]
        assert np.linalg.norm(tip - neck) <= np.linalg.norm(tip - start) + 1e-12
    assert HEAD[0] > HEAD[1] > 0
