"""Distances between shapes in space agree with sampling, and the rows of contacts with motion."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from dynamics.systems.space import (
    Body,
    Box,
    Capsule,
    Cylinder,
    Hull,
    Plane,
    SpatialMachine,
    SpatialPart,
    Sphere,
)

_BOX = Box((0.1, 0.2, 0.3), (0.02, 0.0, 0.01), (0.6, 0.0, 0.8, 0.0))
_ROD = Capsule((-0.1, 0.05, 0.0), (0.2, 0.1, 0.05), 0.06)
_CAN = Cylinder((0.0, 0.0, -0.2), (0.05, 0.0, 0.2), 0.15)
_BALL = Sphere(0.07, (0.01, 0.02, 0.03))


def _machine(one, other, joint: str = "free") -> SpatialMachine:
    bodies = tuple(Body(n, None, 1.0, (0.1, 0.1, 0.1), joint="free") for n in ("a", "b"))
    return SpatialMachine(
        bodies,
        (SpatialPart("one", "a", one), SpatialPart("other", "b", other)),
        (("one", "other"),),
    )


def _core(shape) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return centre, axes and coordinate bounds of a shape's core, and the radius around it."""
    if isinstance(shape, Sphere):
        return np.array(shape.centre), np.eye(3)[:0], np.zeros((0, 2)), float(shape.radius)
    if isinstance(shape, Capsule):
        start, end = np.array(shape.start), np.array(shape.end)
        return start, (end - start)[None], np.array([[0.0, 1.0]]), float(shape.radius)
    turn = Rotation.from_quat(np.roll(shape.quaternion, -1)).as_matrix()
    bounds = np.array([[-h, h] for h in shape.half_size])
    return np.array(shape.centre), turn.T, bounds, 0.0


def _distance(one, other, poses) -> float:
    """Return the distance of two shapes by minimisation over the points of both cores."""
    (c1, a1, b1, r1), (c2, a2, b2, r2) = _core(one), _core(other)
    (R1, p1), (R2, p2) = poses

    def apart(s: np.ndarray) -> float:
        x, y = c1 + s[: len(a1)] @ a1, c2 + s[len(a1) :] @ a2
        return float(np.sum((R1 @ x + p1 - R2 @ y - p2) ** 2))

    bounds = np.concatenate([b1, b2])
    found = (
        [
            minimize(
                apart, bounds.mean(axis=1), bounds=bounds, method="L-BFGS-B", options={"ftol": 1e-16, "gtol": 1e-12}
            ).fun
        ]
        if len(bounds)
        else [apart(np.zeros(0))]
    )
    return float(np.sqrt(min(found))) - r1 - r2


def _poses(seed: int) -> tuple[np.ndarray, list]:
    rng = np.random.default_rng(seed)
    turns = Rotation.random(2, random_state=seed)
    places = rng.normal(size=(2, 3))
    places *= 0.8 / np.linalg.norm(places[0] - places[1])
    both = zip(places, turns, strict=True)
    q = np.concatenate([np.r_[p, np.roll(t.as_quat(), 1)] for p, t in both])
    return q, [(t.as_matrix(), p) for t, p in zip(turns, places, strict=True)]


@pytest.mark.parametrize(
    "pair",
    [
        (_BALL, _BALL),
        (_BALL, _ROD),
        (_BALL, _BOX),
        (_BOX, _BALL),
        (_ROD, _ROD),
        (_ROD, _BALL),
    ],
    ids=lambda pair: "-".join(type(one).__name__ for one in pair),
)
def test_distances_are_those_of_nearest_points(pair) -> None:
    machine = _machine(*pair)
    tree = machine.tree()
    q = ca.SX.sym("q", tree.nq)
    (contact,) = machine.contacts(q).values()
    phi = ca.Function("phi", [q], [contact.phi])
    for seed in range(4):
        at, poses = _poses(seed)
        assert float(phi(at)) == pytest.approx(_distance(*pair, poses), abs=1e-6)


def test_a_ball_beside_a_can() -> None:
    """The ball is beside the can's side, over its cap, off its rim, and inside it."""
    machine = SpatialMachine(
        (Body("a", None, 1.0, (0.1, 0.1, 0.1), joint="free"),),
        (
            SpatialPart("ball", "a", Sphere(0.01)),
            SpatialPart("can", "world", Cylinder((0.0, 0.0, -0.2), (0.0, 0.0, 0.2), 0.15)),
        ),
        (("ball", "can"),),
    )
    q = ca.SX.sym("q", 7)
    (contact,) = machine.contacts(q).values()
    phi = ca.Function("phi", [q], [contact.phi, contact.normal])
    for place, distance, normal in (
        ((0.25, 0.0, 0.1), 0.1, (1, 0, 0)),
        ((0.0, 0.05, 0.3), 0.1, (0, 0, 1)),
        ((0.18, 0.0, 0.24), 0.05, (0.6, 0, 0.8)),
        ((0.0, -0.12, 0.0), -0.03, (0, -1, 0)),
        ((0.0, 0.05, -0.19), -0.01, (0, 0, -1)),
    ):
        found, out = (np.array(one).ravel() for one in phi([*place, 1, 0, 0, 0]))
        assert found[0] == pytest.approx(distance - 0.01, abs=1e-9)
        assert np.allclose(out, normal, atol=1e-9)


def test_inside_a_box_the_nearest_side_decides() -> None:
    """The distance is minus that to the nearest of six sides, and the normal is this side's."""
    half = np.array(_BOX.half_size)
    machine = SpatialMachine(
        (Body("a", None, 1.0, (0.1, 0.1, 0.1), joint="free"),),
        (SpatialPart("ball", "a", Sphere(0.01)), SpatialPart("box", "world", _BOX)),
        (("ball", "box"),),
    )
    q = ca.SX.sym("q", 7)
    (contact,) = machine.contacts(q).values()
    phi = ca.Function("phi", [q], [contact.phi, contact.normal])
    turn, met = Rotation.from_quat(np.roll(_BOX.quaternion, -1)), set()
    for local in np.random.default_rng(0).uniform(-half, half, (60, 3)):
        depth = half - np.abs(local)
        side = int(np.argmin(depth))
        normal = np.sign(local[side]) * np.eye(3)[side]
        found, out = (np.array(v).ravel() for v in phi([*(turn.apply(local) + _BOX.centre), 1, 0, 0, 0]))
        assert found[0] == pytest.approx(-depth[side] - 0.01, abs=1e-9)
        np.testing.assert_allclose(out, turn.apply(normal), atol=1e-9)
        met.add((side, normal[side]))
    assert len(met) == 6


@pytest.mark.parametrize(
    "shape", [_BOX, _CAN, _ROD, Hull(((0.1, 0, 0), (0, 0.2, 0), (0, 0, 0.3)))], ids=lambda one: type(one).__name__
)
def test_the_lowest_point_over_a_plane_is_that_of_the_shape(shape) -> None:
    """The smallest of a shape's distances equals that of a dense sample of its surface."""
    normal = np.array([0.36, 0.48, 0.8])
    machine = SpatialMachine(
        (Body("a", None, 1.0, (0.1, 0.1, 0.1), joint="free"),),
        (
            SpatialPart("one", "a", shape),
            SpatialPart("slope", "world", Plane((0.0, 0.0, -1.0), tuple(map(float, normal)))),
        ),
        (("one", "slope"),),
    )
    q = ca.SX.sym("q", 7)
    least = ca.Function("least", [q], [ca.mmin(ca.vertcat(*(c.phi for c in machine.contacts(q).values())))])
    turn, place = Rotation.random(random_state=3), np.array([0.1, -0.2, 0.4])
    surface = turn.apply(_sample(shape)) + place
    expected = ((surface - [0, 0, -1]) @ normal).min()
    found = float(least(np.r_[place, np.roll(turn.as_quat(), 1)]))
    # A can's rim is rounded by a thousandth, and sampled every half degree.
    assert found == pytest.approx(expected, abs=2e-4)


def _sample(shape) -> np.ndarray:
    rng = np.random.default_rng(0)
    if isinstance(shape, Hull):
        return np.array(shape.points)
    if isinstance(shape, Box):
        turn = Rotation.from_quat(np.roll(shape.quaternion, -1))
        corners = np.array(np.meshgrid(*[[-h, h] for h in shape.half_size])).reshape(3, -1).T
        return turn.apply(corners) + shape.centre
    start, end = np.array(shape.start), np.array(shape.end)
    if isinstance(shape, Capsule):
        out = rng.normal(size=(200_000, 3))
        out *= shape.radius / np.linalg.norm(out, axis=1)[:, None]
        return np.concatenate([start + out, end + out])
    axis = (end - start) / np.linalg.norm(end - start)
    side = np.cross(axis, [1, 0, 0]) / np.linalg.norm(np.cross(axis, [1, 0, 0]))
    angles = np.linspace(0, 2 * np.pi, 721)[:, None]
    ring = shape.radius * (np.cos(angles) * side + np.sin(angles) * np.cross(axis, side))
    return np.concatenate([start + ring, end + ring])


@pytest.mark.parametrize(
    "pair",
    [(_BALL, _BOX), (_ROD, _ROD), (_BALL, _CAN), (_ROD, _BOX)],
    ids=lambda pair: "-".join(type(one).__name__ for one in pair),
)
def test_rows_are_the_motion_at_the_contact(pair) -> None:
    """The normal's row is the derivative of the distance, and all three rows are orthonormal."""
    machine = _machine(*pair)
    tree = machine.tree()
    q, way = ca.SX.sym("q", tree.nq), ca.SX.sym("way", tree.nv)
    contact, one, other = next(iter(machine.contacts_with_bodies(q).values()))
    rows = contact.jacobian_rows(tree.joint_axes(q, one), tree.joint_axes(q, other), tree.nv)
    frame = ca.horzcat(contact.normal, *contact.tangents)
    maps = ca.Function("maps", [q], [ca.vertcat(*rows), frame, contact.phi])
    ahead = ca.Function("ahead", [q, way], [tree.advance(q, way)])
    for seed in range(3):
        at, _ = _poses(seed)
        found, axes, _ = (np.array(one) for one in maps(at))
        h, slope = 1e-6, np.zeros(tree.nv)
        for i in range(tree.nv):
            step = h * np.eye(tree.nv)[i]
            slope[i] = float(maps(ahead(at, step))[2] - maps(ahead(at, -step))[2]) / (2 * h)
        assert np.allclose(found[0], slope, atol=1e-7)
        assert np.allclose(axes.T @ axes, np.eye(3), atol=1e-12)
        assert np.linalg.det(axes[:, [1, 2, 0]]) == pytest.approx(1)


def test_pairs_that_are_not_known_are_told() -> None:
    machine = _machine(_BOX, _BOX)
    with pytest.raises(ValueError, match="Box and Box is not known; take spheres or capsules"):
        machine.contacts(ca.SX.sym("q", 14))
