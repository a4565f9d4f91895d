"""Drawings of solids in perspective: positions, sizes, faces and order follow from geometry."""

from __future__ import annotations

import json
import math
from dataclasses import asdict

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path

from dynamics.systems.space import Box, Capsule, Cylinder, Hull, Plane, Shape, Sphere
from problems import drawing
from problems.machines.perspective import PinholeCamera, frame_seen, solids_seen
from reports.drawing.shapes import bounds, constant_shapes, draw, is_opaque, outline
from reports.drawing.strobe import Forces, forces_drawn, visible_forces

EYE = np.eye(3)
ZERO = np.zeros(3)
CAMERA = PinholeCamera.around((0.1, -0.2, 0.3), 0.8)
rng = np.random.default_rng(3)


def turned(seed: int) -> np.ndarray:
    """Return a random rotation matrix."""
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.linalg.det(q)


def seen(shape: Shape, R: np.ndarray = EYE, p: np.ndarray = ZERO) -> list[drawing.Shape]:
    return solids_seen(CAMERA, [(shape, R, p, "object")])


def places(points: object) -> np.ndarray:
    return CAMERA.project(np.array(points, dtype=float))[0]


def area(polygon: drawing.Shape) -> float:
    """Return the signed area of a polygon, positive for counter-clockwise corners."""
    assert isinstance(polygon, drawing.Outline)
    x, y = np.array(polygon.corners).T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def inside(shape: drawing.Shape, points: np.ndarray, room: float) -> np.ndarray:
    """Return for each point whether it is inside a shape or within ``room`` of its outline."""
    path = Path(outline(shape).vertices) if isinstance(shape, drawing.Outline) else outline(shape)
    return path.contains_points(points, radius=room) | path.contains_points(points, radius=-room)


def test_a_camera_that_looks_along_minus_x_sees_y_on_the_right() -> None:
    camera = PinholeCamera((4.0, 0.0, 1.0), (0.0, 0.0, 1.0))
    found, depth = camera.project(np.array([[0, 1, 1], [0, 0, 2], [2, 1, 1], [-4, 0, 3]]))
    np.testing.assert_allclose(found, [[1, 0], [0, 1], [2, 0], [0, 1]], atol=1e-12)
    np.testing.assert_allclose(depth, [4, 4, 2, 8])
    wide = PinholeCamera(camera.eye, camera.target, focal=0.5)
    np.testing.assert_allclose(wide.project(np.array([[0, 1, 1]]))[0], [[0.5, 0]], atol=1e-12)


def test_the_usual_camera_stands_at_the_front_right_and_above() -> None:
    """In the picture x points right and down, and y right and up."""
    assert np.array(CAMERA.eye) - CAMERA.target == pytest.approx(
        3.2 * np.array([0.5 * math.cos(0.35), -math.sqrt(0.75) * math.cos(0.35), math.sin(0.35)])
    )
    middle, x, y, z = places(CAMERA.target + np.vstack([ZERO, 0.1 * EYE]))
    assert middle == pytest.approx([0, 0])
    assert x[0] > 0 > x[1] and y[0] > 0 and y[1] > 0 and abs(z[0]) < 1e-12 < z[1]
    np.testing.assert_allclose(CAMERA.axes @ CAMERA.axes.T, EYE, atol=1e-12)
    assert np.linalg.det(np.array([*CAMERA.axes[:2], -CAMERA.axes[2]])) == pytest.approx(1)


def test_a_camera_may_look_straight_down() -> None:
    found, depth = PinholeCamera((0, 0, 5), ZERO_PLACE).project(np.array([[1, 0, 0], [0, 1, 0]]))
    np.testing.assert_allclose(found, [[1, 0], [0, 1]], atol=1e-12)
    np.testing.assert_allclose(depth, 5)


ZERO_PLACE = 0.0, 0.0, 0.0


def test_the_disc_of_a_sphere_holds_its_surface_and_is_no_larger() -> None:
    for centre in rng.uniform(-0.3, 0.3, (20, 3)):
        ways = rng.normal(size=(500, 3))
        surface = centre + 0.1 * ways / np.linalg.norm(ways, axis=1)[:, None]
        (disc,) = seen(Sphere(0.1), p=centre)
        assert isinstance(disc, drawing.Circle)
        away = np.linalg.norm(places(surface) - (disc.x, disc.y), axis=1)
        assert 0.97 < away.max() / disc.radius < 1.02


def test_a_point_is_a_disc_without_radius() -> None:
    (disc,) = seen(Sphere(0.0))
    assert isinstance(disc, drawing.Circle) and disc.radius == 0


@pytest.mark.parametrize(
    "shape",
    [
        Capsule((-0.1, 0, 0), (0.1, 0.05, 0.1), 0.04),
        Capsule((-0.2, 0.4, 0), (0.2, -0.4, 0.1), 0.04),
        Cylinder((0, 0, -0.2), (0.1, 0, 0.2), 0.1),
        Box((0.1, 0.2, 0.05)),
        Hull(tuple(map(tuple, rng.normal(size=(20, 3)) * 0.1))),
    ],
    ids=["capsule", "long capsule", "cylinder", "box", "hull"],
)
@pytest.mark.parametrize("seed", range(3))
def test_what_is_drawn_of_a_solid_holds_all_of_it(shape: Shape, seed: int) -> None:
    R, p = turned(seed), np.array([0.1, -0.1, 0.2])
    match shape:
        case Capsule(start, end, radius):
            ways = rng.normal(size=(400, 3))
            ends = np.array([start, end])[rng.integers(0, 2, 400)]
            own = ends + radius * ways / np.linalg.norm(ways, axis=1)[:, None]
        case Cylinder(start, end, radius):
            along = np.subtract(end, start)
            ways = np.cross(along, rng.normal(size=(400, 3)))
            ends = np.array([start, end])[rng.integers(0, 2, 400)]
            own = ends + radius * ways / np.linalg.norm(ways, axis=1)[:, None]
        case Box(half):
            own = (2 * np.array([*np.ndindex(2, 2, 2)]) - 1) * half
        case Hull(points):
            own = np.array(points)
    drawn = seen(shape, R, p)
    found = places(own @ R.T + p)
    # Discs and rings have 32 corners, and a sphere far from the middle is no disc.
    room = {Capsule: 5e-3, Cylinder: 1e-3}.get(type(shape), 1e-6)
    assert np.any([inside(one, found, room) for one in drawn], axis=0).all()
    assert all(area(one) > 0 for one in drawn if isinstance(one, drawing.Outline))
    low, high = bounds(drawn)
    assert (low <= found.min(axis=0) + room).all() and (high >= found.max(axis=0) - room).all()
    assert np.ptp(found, axis=0) == pytest.approx(high - low, rel=0.06, abs=1e-3)


def test_a_hull_of_points_on_a_line_is_drawn_from_end_to_end() -> None:
    points = (0.0, 0.0, 0.0), (0.1, 0.1, 0.1), (0.2, 0.2, 0.2)
    found = places(points)
    expected = [found.min(axis=0), found.max(axis=0)]
    np.testing.assert_allclose(bounds(seen(Hull(points))), expected, atol=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_the_sides_of_a_box_that_are_seen_face_the_eye(seed: int) -> None:
    R, p, half = turned(seed), np.array([0.2, 0.1, 0.3]), np.array([0.1, 0.2, 0.3])
    expected = set()
    for axis in range(3):
        for sign in (-1, 1):
            middle = p + sign * half[axis] * R[:, axis]
            if (CAMERA.eye - middle) @ (sign * R[:, axis]) > 0:
                signs = [s for s in np.ndindex(2, 2, 2) if 2 * s[axis] - 1 == sign]
                corners = p + (2 * np.array(signs) - 1) * half @ R.T
                expected.add(frozenset(map(tuple, places(corners).round(9).tolist())))
    drawn = seen(Box((0.1, 0.2, 0.3)), R, p)
    found = {frozenset((round(x, 9), round(y, 9)) for x, y in one.corners) for one in drawn}
    assert found == expected and 1 <= len(drawn) <= 3
    assert len({one.shade for one in drawn}) == len(drawn), "an edge parts two greys"


def test_a_turned_box_is_a_box_on_a_turned_body() -> None:
    turn = math.cos(0.4), 0.0, 0.0, math.sin(0.4)
    c, s = math.cos(0.8), math.sin(0.8)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    one, other = seen(Box((0.1, 0.2, 0.3), quaternion=turn)), seen(Box((0.1, 0.2, 0.3)), R)
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(a.corners, b.corners, atol=1e-12)


def test_the_cap_of_a_cylinder_that_is_seen_is_the_one_towards_the_eye() -> None:
    side, cap = seen(Cylinder((0, 0, 0), (0, 0, 0.3), 0.1))
    assert isinstance(cap, drawing.Outline) and area(cap) < area(side)
    ring = places([(0.1, 0, 0.3), (0, 0.1, 0.3), (-0.1, 0, 0.3)])
    np.testing.assert_allclose(np.array(cap.corners)[::8][:3], ring, atol=1e-12)


def roles(*solids: tuple[Shape, np.ndarray, str]) -> list[str]:
    """Return the roles of solids from back to front; their order in the list must not matter."""
    given = [(shape, EYE, np.array(p, dtype=float), role) for shape, p, role in solids]
    orders = [list(dict.fromkeys(one.role for one in solids_seen(CAMERA, way))) for way in (given, given[::-1])]
    assert orders[0] == orders[1]
    return orders[0]


def test_what_is_deeper_is_drawn_first() -> None:
    near, far = (np.array(CAMERA.target) + way * CAMERA.axes[2] for way in (-0.3, 0.3))
    assert roles((Sphere(0.1), near, "object"), (Sphere(0.1), far, "goal")) == ["goal", "object"]


def test_a_foot_far_out_on_a_wide_table_is_drawn_over_it() -> None:
    """It is drawn over the table although its middle is deeper, and below if it is under the table."""
    table, back = Box((1.0, 1.0, 0.05)), 0.8 * CAMERA.axes[2][:2]
    on, under = np.array([*back, 0.08]), np.array([*-back, -0.08])
    assert roles((table, ZERO, "goal"), (Sphere(0.03), on, "object")) == ["goal", "object"]
    assert roles((table, ZERO, "goal"), (Sphere(0.03), under, "object")) == ["object", "goal"]


def test_a_floor_is_a_grid_below_all_else_and_the_same_in_every_frame() -> None:
    floor = (Plane(), EYE, np.zeros(3), "environment")
    frames = [solids_seen(CAMERA, [(Sphere(0.1), EYE, np.array([x, 0, 0.1]), "object"), floor]) for x in (0.0, 0.1)]
    lines = constant_shapes(frames, [is_opaque(one) for one in frames[0]])
    assert lines == frames[0][:-1] and len(lines) > 30
    assert all(isinstance(one, drawing.Segment) and one.role == "environment" for one in lines)
    np.testing.assert_allclose(bounds(frames[0]), bounds(frames[0][-1:]), err_msg="no line counts")
    assert solids_seen(CAMERA, [floor]) == lines


def test_the_lines_of_a_floor_are_round_numbers_of_metres_apart() -> None:
    """Each line is the projection of a line x = k / 4 or y = k / 4 on the floor."""
    eye, axes = np.array(CAMERA.eye), CAMERA.axes
    for line in solids_seen(CAMERA, [(Plane(), EYE, ZERO, "environment")]):
        assert isinstance(line, drawing.Segment)
        spots = []
        for x, y in ((line.x1, line.y1), (line.x2, line.y2)):
            way = np.array([x, y, CAMERA.distance]) @ axes
            spots.append((eye - way * eye[2] / way[2])[:2])
        same = np.abs(np.diff(spots, axis=0)[0]) < 1e-9
        assert same.sum() == 1
        assert 4 * spots[0][same] == pytest.approx(np.round(4 * spots[0][same]), abs=1e-9)


def test_shades_are_solid_and_flat_shapes_are_as_they_were() -> None:
    axis = Figure().subplots()
    flat, solid = (draw(drawing.Circle(0, 0, 1, shade=s), axis, 1.0) for s in (0.0, 0.3))
    assert isinstance(flat, PathPatch) and isinstance(solid, PathPatch)
    assert flat.get_facecolor()[3] == 0.25 and solid.get_facecolor()[3] == 1
    ink = np.array(flat.get_facecolor()[:3])
    np.testing.assert_allclose(solid.get_facecolor()[:3], 1 + 0.3 * (ink - 1))
    line = draw(drawing.Segment(0, 0, 1, 1, shade=0.4), axis, 1.0)
    assert line.get_zorder() == solid.get_zorder() < draw(drawing.Segment(0, 0, 1, 1), axis, 1.0).get_zorder()


def test_what_hides_is_only_drawn_once_if_nothing_comes_below_it() -> None:
    wall, floor = drawing.Circle(0, 0, 1, shade=0.3), drawing.Segment(0, 0, 1, 0, shade=0.4)
    mark = drawing.Mark(0, 0)
    frames = [[floor, drawing.Circle(x, 0, 1, shade=0.3), wall, mark] for x in (0.1, 0.2)]
    assert constant_shapes(frames, [is_opaque(one) for one in frames[0]]) == [floor, mark]


def test_polygons_come_back_from_a_file_as_they_were() -> None:
    polygon = drawing.Outline(((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)), shade=0.2)
    again = drawing.Outline(**json.loads(json.dumps(asdict(polygon))))
    assert again == polygon and hash(again) == hash(polygon)


@pytest.mark.parametrize("normal", [(0, 0, 1), (1, 0, 0), (0.6, 0, 0.8), (0, -1, 0)])
def test_a_frame_has_the_normal_as_it_looks(normal: tuple[float, float, float]) -> None:
    point, way = np.array([0.2, 0.1, 0.05]), np.array(normal, dtype=float)
    frame = frame_seen(CAMERA, point, way, 0.5)
    ends = places([point - 1e-5 * way, point, point + 1e-5 * way])
    assert (frame.x, frame.y) == pytest.approx(ends[1])
    assert (frame.nx, frame.ny) == pytest.approx((ends[2] - ends[0]) / 2e-5, abs=1e-8)


@pytest.mark.parametrize("normal", [(0, 0, 1), (1, 0, 0), (0.6, 0, 0.8)])
def test_a_cone_is_as_wide_as_it_looks(normal: tuple[float, float, float]) -> None:
    """For a distant camera the edges of its picture are the outermost of its rays."""
    way, friction = np.array(normal, dtype=float), 0.4
    camera = PinholeCamera((500.0, -800.0, 400.0))
    frame = frame_seen(camera, ZERO, way, friction)
    ring = np.array([(math.cos(a), math.sin(a)) for a in np.linspace(0, 2 * math.pi, 2000)])
    right = np.cross(way, (0, 1, 0))
    rays = way + friction * ring @ np.array([right, np.cross(way, right)])
    x, y = camera.project(rays)[0].T
    turns = np.angle((x + 1j * y) / (frame.nx + 1j * frame.ny))
    assert math.atan(frame.friction) == pytest.approx(np.abs(turns).max(), rel=1e-2)


def test_a_cone_that_points_to_the_eye_is_left_out() -> None:
    frame = frame_seen(CAMERA, np.array(CAMERA.target), -CAMERA.axes[2], 0.5)
    assert frame.friction == 0 and math.hypot(frame.nx, frame.ny) < 1e-12
    pushes = np.ones(1), np.zeros(1)
    assert not list(visible_forces([frame], pushes, 1.0)), "an arrow without length has no direction"


def test_of_a_force_in_space_the_normal_part_is_drawn() -> None:
    forces = Forces(np.array([[3.0]]), np.array([[4.0]]), "N s")
    frame = frame_seen(CAMERA, ZERO, EYE[2], 0.5)
    flat = drawing.ContactFrame(0, 0, 0, 1)
    shown = forces_drawn(forces, [[frame]])
    assert shown is not None and shown.largest == 3 and forces_drawn(forces, [[flat]]) is forces
    assert forces_drawn(None, [[frame]]) is None
