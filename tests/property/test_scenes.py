"""Gaps, gradients and slips of scenes agree with sampled geometry and closed forms."""

from __future__ import annotations

import functools

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from dynamics.systems.shapes import Shape
from problems.scenes import Body, Box, Capsule, Disc, HalfPlane, Obstacle, Pusher, Scene
from problems.scenes.things import Thing
from tests.examples import settings

SHAPES = {
    "disc": Disc(0.2, (0.05, -0.02)),
    "box": Box((0.3, 0.15)),
    "rounded": Box((0.2, 0.25), 0.08),
    "capsule": Capsule((-0.2, 0.0), (0.25, 0.1), 0.06),
}


def rim(shape: Shape, n: int = 4001) -> np.ndarray:
    """Return points of a shape's boundary in its own frame, (n, 2), at most a few 1e-4 apart."""
    angle = np.linspace(0, 2 * np.pi, n)
    round_ = np.column_stack([np.cos(angle), np.sin(angle)])
    if isinstance(shape, Disc):
        return np.array(shape.centre) + shape.radius * round_
    if isinstance(shape, Box):
        core = np.array(shape.half_size) - shape.radius
        corners = core * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    else:
        assert isinstance(shape, Capsule)
        corners = np.array([shape.start, shape.end])
    # The boundary of a rounded convex body is that of its core, moved out by the radius.
    edges = [np.linspace(corners[i - 1], corners[i], n // 4) for i in range(len(corners))]
    outward = [shape.radius * round_ + corner for corner in corners]
    flat = []
    for edge in edges:
        along = edge[-1] - edge[0]
        normal = np.array([along[1], -along[0]]) / np.hypot(*along)
        flat += [edge + side * shape.radius * normal for side in (-1, 1)]
    return np.vstack([*outward, *flat])


def anticlockwise(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def placed(shape: object, x: float, y: float, angle: float) -> np.ndarray:
    return rim(shape) @ anticlockwise(angle).T + [x, y]


def looked_at(scene: Scene) -> ca.Function:
    """Return the function from q to distances, points, normals, rows of slip, and slopes of the distances."""
    q = ca.SX.sym("q", len(scene.coordinates))
    found, phi = scene.contacts(q), scene.distance(q)
    points, normals = (ca.horzcat(*each) for each in zip(*((c.point, c.normal) for c in found), strict=True))
    parts = [phi, points, normals, scene.sliding(q), ca.jacobian(phi, q)]
    return ca.Function("look", [q], [ca.densify(part) for part in parts])


def at(look: ca.Function, q: np.ndarray) -> list[np.ndarray]:
    return [np.array(v) for v in look(q)]


@pytest.mark.cheap_cases("disc-disc", "disc-capsule")
@pytest.mark.parametrize("mine", SHAPES)
@pytest.mark.parametrize("theirs", SHAPES)
@settings(max_examples=6, deadline=None)
@given(
    where=st.tuples(st.floats(0.45, 0.9), st.floats(-3, 3)),
    turn=st.floats(-3, 3),
    other=st.floats(-3, 3),
)
def test_the_least_gap_is_the_distance_of_the_rims(mine, theirs, where, turn, other) -> None:
    """Both bodies are rotated, and their corners are separate contacts if both have sides."""
    body = Body("object", SHAPES[mine], at=(0.0, 0.0), inertia=0.1)
    scene = Scene([body, Obstacle("post", SHAPES[theirs], at=(0.1, 0.2), angle=other)])
    x, y = 0.1 + where[0] * np.cos(where[1]), 0.2 + where[0] * np.sin(where[1])
    phi = at(looked_at(scene), np.array([x, y, turn]))[0]
    one, two = placed(SHAPES[mine], x, y, turn), placed(SHAPES[theirs], 0.1, 0.2, other)
    apart = float(phi.min())
    if apart < 0.02:  # sampled rims that are near or cross give no good distance
        return
    sampled = cKDTree(two).query(one)[0].min()
    assert apart == pytest.approx(sampled, abs=1e-3)


@pytest.mark.costly
@settings(max_examples=25, deadline=None)
@given(turn=st.floats(-3, 3), height=st.floats(0.5, 1.0), slope=st.floats(-1.0, 1.0))
def test_every_corner_has_its_height_over_a_slope(turn, height, slope) -> None:
    normal = (float(-np.sin(slope)), float(np.cos(slope)))
    scene = Scene(
        [
            Body("block", Box((0.3, 0.15)), at=(0.0, height), inertia=0.1),
            Obstacle("slope", HalfPlane(normal=normal), at=(0.0, 0.0)),
        ]
    )
    assert [touch.name for touch in scene.touches] == [f"block on slope {i}" for i in range(1, 5)]
    phi = at(looked_at(scene), np.array([0.1, height, turn]))[0].ravel()
    corners = np.array([[0.3, 0.15], [-0.3, 0.15], [-0.3, -0.15], [0.3, -0.15]])
    heights = (corners @ anticlockwise(turn).T + [0.1, height]) @ normal
    np.testing.assert_allclose(np.sort(phi), np.sort(heights), atol=1e-12)


@functools.cache
def three() -> tuple[Scene, ca.Function]:
    """Return a scene of pushers on a rail and in the plane, bodies with and without rotation, and a wall."""
    made = Scene(
        [
            Pusher("cart", Box((0.2, 0.1)), at=(-1.0, 0.0), axis=(0.6, 0.8), mass=2.0, stiffness=40.0),
            Body("block", Box((0.15, 0.25), 0.05), at=(0.0, 0.1), mass=1.5, inertia=0.07),
            Body("puck", Disc(0.2), at=(0.7, 0.3), mass=0.5),
            Pusher("hand", Disc(0.1), at=(0.2, 0.9), mass=0.7, stiffness=60.0),
            Obstacle("wall", HalfPlane(normal=(-1.0, 0.0)), at=(2.0, 0.0)),
        ],
        friction=0.4,
    )
    return made, looked_at(made)


@pytest.mark.costly
@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_gradients_and_slips_are_those_of_points_that_move(seed: int) -> None:
    """Rows agree with differences of the gaps, and of material points that move with the bodies."""
    (scene, look), rng = three(), np.random.default_rng(seed)
    q = np.array([0.0, 0.1, 0.3, 0.7, 0.3, 0.1, 0.2, 0.9]) + 0.1 * rng.normal(size=8)
    _, point, normal, slides, slopes = at(look, q)
    e = 1e-6
    for j, way in enumerate(np.eye(8)):
        ahead, behind = at(look, q + e * way), at(look, q - e * way)
        rise = (ahead[0] - behind[0]).ravel() / (2 * e)
        np.testing.assert_allclose(slopes[:, j], rise, atol=2e-5)
        for i, touch in enumerate(scene.touches):
            moved = _travel(scene, touch.one, point[:, i], q, e * way)
            moved = moved - _travel(scene, touch.other, point[:, i], q, e * way)
            tangent = np.array([normal[1, i], -normal[0, i]])
            assert slides[i, j] == pytest.approx(tangent @ moved / (2 * e), abs=1e-6)


def _travel(scene: Scene, thing: Thing, point: np.ndarray, q: np.ndarray, way: np.ndarray) -> np.ndarray:
    """Return the displacement of a thing's material point from q - way to q + way."""
    frames = [_frame(scene, thing, value) for value in (q, q - way, q + way)]
    local = frames[0][1].T @ (point - frames[0][0])
    behind, ahead = (origin + turn @ local for origin, turn in frames[1:])
    return ahead - behind


def _frame(scene: Scene, thing: Thing, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    own = np.array(ca.DM(scene.coordinates_of(thing.name, ca.SX(q)))).ravel() if thing.coordinates else []
    start = np.array([float(v) for v in thing.at])
    match len(own):
        case 3:
            return np.array(own[:2]), anticlockwise(own[2])
        case 2:
            return np.array(own), np.eye(2)
        case 1:
            return start + own[0] * np.array([0.6, 0.8]), np.eye(2)
    return start, np.eye(2)
