"""Shapes on axes: every kind is drawn at the right position."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.path import Path as Outline

from problems import names, spec
from problems.drawing import Circle, ContactFrame, Mark, Rectangle, Segment, Spring, Stadium, Wall
from reports.drawing import shapes


def outline(shape) -> np.ndarray:
    """Return the points (n, 2) of a drawn outline [m]."""
    axis = Figure().subplots()
    patch = shapes.draw(shape, axis, 1.0)
    to_metres = patch.get_transform() - axis.transData
    return to_metres.transform(patch.get_path().vertices)


@pytest.mark.costly_cases("half-cheetah", "quadruped", "ant", "push-cube", "reorient")
@pytest.mark.parametrize("name", names())
def test_every_problem_is_drawn(name: str) -> None:
    """All shapes of every problem can be drawn, within finite limits."""
    found = spec(name)
    assert found.draw is not None
    params = found.params({})
    start = found.problem().initial_states(found.problem().parameters.values)[0]
    axis = Figure().subplots()
    drawn = found.draw(params, start)
    assert np.all(np.isfinite(shapes.bounds(drawn)))
    for shape in drawn:
        shapes.draw(shape, axis, 1.0)
    assert len(axis.lines) + len(axis.patches) == len(drawn)


@pytest.mark.parametrize(
    "shape",
    [
        Circle(0, 0, 1),
        Rectangle(0, 0, 2, 1, 0.3),
        Rectangle(0, 0, 2, 1, 0.3, rounding=0.2),
        Stadium(0, 0, 1, 1, 0.1),
        Segment(0, 0, 1, 1),
        Spring(0, 0, 1, 0),
        Mark(0, 0),
        Wall(0, 0, 0, 1),
    ],
    ids=lambda shape: type(shape).__name__,
)
def test_every_shape_is_one_artist_that_can_be_taken_away(shape) -> None:
    axis = Figure().subplots()
    artist = shapes.draw(shape, axis, 0.5)
    assert [artist] == [*axis.lines, *axis.patches]
    artist.remove()
    assert not [*axis.lines, *axis.patches]


def test_a_half_plane_lies_behind_its_normal() -> None:
    axis = Figure().subplots()
    axis.set_xlim(-1, 1)
    axis.set_ylim(-1, 1)
    shapes.draw(Wall(0, 0, 0, 1), axis, 1.0)
    (patch,) = axis.patches
    assert patch.get_path().contains_point((0, -0.5))
    assert not patch.get_path().contains_point((0, 0.5))


def test_a_half_plane_reaches_wherever_the_view_is() -> None:
    axis = Figure().subplots()
    axis.set_xlim(999, 1001)
    axis.set_ylim(-1, 1)
    floor = shapes.draw(Wall(0, 0, 0, 1), axis, 1.0).get_path()
    assert floor.contains_point((999, -0.5)) and floor.contains_point((1001, -0.01))
    assert not floor.contains_point((1000, 0.01))


def test_a_turned_box_has_its_corner_where_geometry_says() -> None:
    corners = outline(Rectangle(1, 2, 2, 0, angle=np.pi / 2))
    np.testing.assert_allclose(corners[:, 0], 1, atol=1e-9)
    assert {round(y, 9) for y in corners[:, 1]} == {1.0, 3.0}


def distance_to_segment(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    along = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
    return np.linalg.norm(points - a - along[:, None] * (b - a), axis=1)


@pytest.mark.parametrize("b", [(3.0, 1.0), (-2.0, 1.5), (0.5, -4.0), (0.5, 1.0)])
def test_the_outline_of_a_capsule_is_its_radius_from_its_segment(b: tuple[float, float]) -> None:
    a = np.array([0.5, 1.0])
    points = outline(Stadium(*a, *b, 0.25))
    if tuple(a) == b:
        assert Outline(points).get_extents().size == pytest.approx([0.5, 0.5])
        return
    np.testing.assert_allclose(distance_to_segment(points, a, np.array(b)), 0.25, atol=1e-12)
    extent = shapes.bounds([Stadium(*a, *b, 0.25)])
    np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], extent, atol=3e-3)


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_a_rounded_box_keeps_its_sides_and_loses_its_corners(angle: float) -> None:
    """In the box's frame the signed distance to a rounded box is zero along the whole outline."""
    width, height, radius = 2.0, 1.0, 0.3
    points = outline(Rectangle(3, -1, width, height, angle, rounding=radius)) - (3, -1)
    c, s = np.cos(angle), np.sin(angle)
    own = np.abs(points @ np.array([[c, -s], [s, c]]))
    assert own.max(axis=0) == pytest.approx([width / 2, height / 2])
    beyond = np.maximum(own - (width / 2 - radius, height / 2 - radius), 0)
    np.testing.assert_allclose(np.linalg.norm(beyond, axis=1), radius, atol=1e-12)


def test_the_tangent_is_the_normal_turned_clockwise() -> None:
    frame = ContactFrame(0, 0, 0.6, 0.8, friction=0.5)
    turned = np.array([[0, 1], [-1, 0]]) @ (frame.nx, frame.ny)
    assert frame.tangent == pytest.approx(tuple(turned))
    assert ContactFrame(0, 0, 0, 1).tangent == (1, 0)
