"""A shape with an offset centre equals the centred shape of a body at that position."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.systems import WORLD, space
from dynamics.systems.shapes import Box, Capsule, Contact, Disc, Polygon, Pose, Shape, Union
from dynamics.systems.shapes.areas import shape_area
from dynamics.systems.shapes.polygon import box_polygon
from problems.drawing import Rectangle, solid
from problems.scenes import Body, Pusher, Scene

CENTRE, KITE = (0.3, -0.2), [(0.2, 0.0), (0.0, 0.1), (-0.1, 0.0), (0.0, -0.1)]
PAIRS = [
    (Box((0.2, 0.1)), Box((0.2, 0.1), centre=CENTRE)),
    (Box((0.2, 0.1), 0.03), Box((0.2, 0.1), 0.03, CENTRE)),
    (Polygon(KITE), Polygon(KITE, centre=CENTRE)),
    (Polygon(KITE, 0.01), Polygon(KITE[::-1], 0.01, CENTRE)),
    (box_polygon(Box((0.2, 0.1))), box_polygon(Box((0.2, 0.1), centre=CENTRE))),
]


def pose(x: float, z: float, angle: float) -> Pose:
    return Pose(ca.SX([x, z]), ca.SX(angle))


@pytest.mark.cheap_cases("plain0-placed0")
@pytest.mark.parametrize(("plain", "placed"), PAIRS)
def test_distances_are_those_of_the_body_moved_there(plain: Shape, placed: Shape) -> None:
    rng = np.random.default_rng(0)
    for x, z, angle, *at in rng.uniform(-1, 1, (20, 5)):
        body = pose(x, z, angle)
        moved = Pose(body.to_world(CENTRE), body.angle)
        point = pose(*at, 0.0)
        for probe in (Disc(0.05), Capsule((0.0, 0.0), (0.1, 0.2), 0.02)):
            if isinstance(plain, Box | Polygon):
                one = Contact.between(probe, point, placed, body)
                other = Contact.between(probe, point, plain, moved)
                for name in ("phi", "normal", "point"):
                    values = (np.array(ca.DM(getattr(each, name))) for each in (one, other))
                    np.testing.assert_allclose(*values, atol=1e-12)


@pytest.mark.parametrize(("plain", "placed"), PAIRS)
def test_area_moves_with_the_centre(plain: Shape, placed: Shape) -> None:
    one, other = shape_area(plain), shape_area(placed)
    assert float(one.area) == pytest.approx(float(other.area))
    shift = np.array(ca.DM(other.centre - one.centre)).ravel()
    np.testing.assert_allclose(shift, CENTRE, atol=1e-12)


def test_a_box_is_drawn_at_its_centre() -> None:
    drawn = solid(Box((0.2, 0.1), centre=CENTRE), 1.0, 2.0, np.pi / 2, "object")
    assert isinstance(drawn, Rectangle)
    np.testing.assert_allclose((drawn.x, drawn.y), (1.0 - 0.2, 2.0 - 0.3), atol=1e-12)


def test_an_l_of_two_boxes_has_the_centroid_of_its_parts() -> None:
    foot, post = Box((0.2, 0.05), centre=(0.2, 0.05)), Box((0.05, 0.2), centre=(0.05, 0.3))
    whole = shape_area(Union([foot, post]))
    assert float(whole.area) == pytest.approx(2 * 0.4 * 0.1)
    np.testing.assert_allclose(np.array(ca.DM(whole.centre)).ravel(), [0.125, 0.175])
    scene = Scene(
        [Body.uniform("l", Union([foot, post]), (0.0, 0.0)), Pusher("tip", Disc(0.05), (1.0, 0.0), stiffness=100.0)]
    )
    assert float(scene.distance(scene.start)[0]) > 0


def test_wrong_centres_are_refused() -> None:
    for make in (lambda: Box((1, 1), centre=(0, 0, 0)), lambda: Polygon(KITE, centre="here")):
        with pytest.raises(ValueError, match="centre must be two numbers"):
            make()


def test_the_world_has_one_name() -> None:
    assert space.WORLD == WORLD == "world"
