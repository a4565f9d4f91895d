"""Contacts between any two shapes agree with distances by convex programs and gradients by differences."""

from __future__ import annotations

from itertools import combinations_with_replacement
from typing import NamedTuple

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from dynamics.systems.shapes import Box, Capsule, Contact, Disc, HalfPlane, Pose, Shape
from tests.examples import settings


class Solid(NamedTuple):
    """A shape, and its core ``centre + frame s`` for s in the box [-1, 1]², to be grown by ``radius``."""

    shape: Shape
    centre: np.ndarray
    frame: np.ndarray
    radius: float


def box(half: tuple[float, float], radius: float) -> Solid:
    return Solid(Box(half, radius), np.zeros(2), np.diag(np.array(half) - radius), radius)


SOLIDS = {
    "disc": Solid(Disc(0.15, (0.1, -0.05)), np.array([0.1, -0.05]), np.zeros((2, 2)), 0.15),
    "capsule": Solid(
        Capsule((-0.2, 0.0), (0.3, 0.1), 0.08), np.array([0.05, 0.05]), np.array([[0.25, 0.0], [0.05, 0.0]]), 0.08
    ),
    "box": box((0.3, 0.2), 0.0),
    "rounded box": box((0.25, 0.35), 0.1),
}
PAIRS = list(combinations_with_replacement(SOLIDS, 2))
every_pair = pytest.mark.parametrize(("one", "other"), PAIRS)
poses = st.tuples(*[st.floats(-0.7, 0.7)] * 2, st.floats(-3, 3), st.floats(-3, 3))


def functions(one: Shape, other: Shape) -> ca.Function:
    """Return the function from q = (x, z, a) of both bodies to gap, normal, tangent, point, J_n, J_t."""
    q = ca.SX.sym("q", 6)
    c = Contact.between(one, Pose(q[:2], q[2]), other, Pose(q[3:5], q[5]))
    outputs = [c.phi, c.normal, c.tangent, c.point, *map(ca.densify, c.jacobians(q))]
    return ca.Function("contact", [q], outputs)


CONTACTS = {pair: functions(*(SOLIDS[name].shape for name in pair)) for pair in PAIRS}
SWAPPED = {pair: functions(*(SOLIDS[name].shape for name in reversed(pair))) for pair in PAIRS}


def rotation(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s], [-s, c]])


def configuration(pose: tuple[float, ...]) -> np.ndarray:
    return np.array([pose[0], pose[1], pose[2], 0.0, 0.0, pose[3]])


def apart(one: Solid, other: Solid, q: np.ndarray) -> float:
    """Return the distance of the two cores, from a convex quadratic program over a box."""
    frames, centres = [], []
    for solid, at in ((one, q[:3]), (other, q[3:])):
        frames.append(rotation(at[2]) @ solid.frame)
        centres.append(at[:2] + rotation(at[2]) @ solid.centre)
    A, b = np.hstack([frames[0], -frames[1]]), centres[0] - centres[1]
    nearest = lsq_linear(A, -b, bounds=(-1, 1), method="bvls", tol=1e-14).x
    return float(np.hypot(*(A @ nearest + b)))


def values(pair: tuple[str, str], q: np.ndarray) -> list[np.ndarray]:
    return [np.array(v).ravel() for v in CONTACTS[pair](q)]


def smooth(pair: tuple[str, str], q: np.ndarray) -> bool:
    """Return whether the cores are apart and no side of one is parallel to a side of the other.

    Then the nearest pair of points is unique: two convex polygons that are apart have a second one
    only along parallel sides.
    """
    one, other = (SOLIDS[name] for name in pair)
    if apart(one, other, q) < 1e-2:
        return False
    ours, theirs = (rotation(at) @ s.frame for s, at in ((one, q[2]), (other, q[5])))
    crossed = np.outer(ours[0], theirs[1]) - np.outer(ours[1], theirs[0])
    lengths = np.outer(np.hypot(*ours), np.hypot(*theirs))
    return bool((np.abs(crossed) >= 1e-4 * lengths).all())


@pytest.mark.cheap_cases("disc-disc", "disc-capsule", "disc-box", "disc-rounded box", "capsule-capsule")
@every_pair
@given(pose=poses)
@settings(max_examples=60)
def test_gap_is_the_distance_of_the_cores_less_both_radii(one, other, pose) -> None:
    q, a, b = configuration(pose), SOLIDS[one], SOLIDS[other]
    between = apart(a, b, q)
    assume(between > 1e-3)
    phi, normal, tangent, point, *_ = values((one, other), q)
    assert phi.item() == pytest.approx(between - a.radius - b.radius, abs=1e-6)
    assert normal @ normal == pytest.approx(1, abs=1e-12)
    assert normal @ tangent == pytest.approx(0, abs=1e-15)
    # Both nearest points are on the surface of their own shape.
    for solid, body, place in ((a, q[:3], point), (b, q[3:], point - phi * normal)):
        dot = Solid(Disc(0.0), place, np.zeros((2, 2)), 0.0)
        on = np.concatenate([body, np.zeros(3)])
        assert apart(solid, dot, on) == pytest.approx(solid.radius, abs=1e-5)


@pytest.mark.cheap_cases("disc-disc", "disc-capsule", "capsule-rounded box")
@every_pair
@given(pose=poses)
@settings(max_examples=60)
def test_gradient_of_the_gap_against_differences(one, other, pose) -> None:
    q, eps, pair = configuration(pose), 1e-7, (one, other)
    assume(smooth(pair, q))
    rises = [values(pair, q + e)[0] - values(pair, q - e)[0] for e in eps * np.eye(6)]
    np.testing.assert_allclose(values(pair, q)[4], np.ravel(rises) / (2 * eps), atol=5e-6)


@pytest.mark.cheap_cases("disc-disc", "disc-capsule", "disc-box", "disc-rounded box")
@every_pair
@given(pose=poses)
@settings(max_examples=30)
def test_action_is_reaction(one, other, pose) -> None:
    """The order of the shapes changes signs alone, and forces neither move nor rotate both as one body."""
    q = configuration(pose)
    assume(smooth((one, other), q))
    phi, normal, _, point, J_n, J_t = values((one, other), q)
    back = np.concatenate([q[3:], q[:3]])
    swapped = [np.array(v).ravel() for v in SWAPPED[(one, other)](back)]
    assert swapped[0] == pytest.approx(phi, abs=1e-12)
    np.testing.assert_allclose(swapped[1], -normal, atol=1e-9)
    np.testing.assert_allclose(swapped[3], point - phi * normal, atol=1e-9)
    # Two translations, and a rotation about the world's origin: d(x, z) = (z, -x) da.
    rigid = np.array([[1, 0, 0, 1, 0, 0], [0, 1, 0, 0, 1, 0], [q[1], -q[0], 1, q[4], -q[3], 1]])
    np.testing.assert_allclose(rigid @ np.column_stack([J_n, J_t]), 0, atol=1e-12)


@pytest.mark.one_case_in(2)
@pytest.mark.parametrize("name", list(SOLIDS))
@given(pose=poses)
@settings(max_examples=40)
def test_height_over_a_half_plane_is_that_of_the_lowest_point(name, pose) -> None:
    solid, (x, z, angle, slope) = SOLIDS[name], pose
    tilted = HalfPlane((0.1, 0.2), (float(np.sin(slope)), float(np.cos(slope))))
    phi = functions(solid.shape, tilted)(np.array([x, z, angle, 0, 0, 0]))[0]
    signs = np.array([[a, b] for a in (-1, 1) for b in (-1, 1)])
    corners = (solid.centre + signs @ solid.frame.T) @ rotation(angle).T + [x, z]
    heights = (corners - [0.1, 0.2]) @ [np.sin(slope), np.cos(slope)]
    assert float(phi) == pytest.approx(heights.min() - solid.radius, abs=1e-12)


def test_a_corner_in_a_box_is_as_deep_as_it_is() -> None:
    """A square's corner is 0.05 m deep in the top of another box, then 0.02 m in its side."""
    boxes = functions(Box((0.2, 0.2)), Box((0.5, 0.3)))
    diagonal = 0.2 * np.sqrt(2)
    phi, normal, _, point, *_ = (np.array(v).ravel() for v in boxes([0.1, 0.3 + diagonal - 0.05, np.pi / 4, 0, 0, 0]))
    assert phi.item() == pytest.approx(-0.05)
    np.testing.assert_allclose(normal, [0, 1], atol=1e-12)
    np.testing.assert_allclose(point, [0.1, 0.25], atol=1e-12)
    phi, normal, *_ = (np.array(v).ravel() for v in boxes([0.5 + diagonal - 0.02, 0.0, np.pi / 4, 0, 0, 0]))
    assert phi.item() == pytest.approx(-0.02)
    np.testing.assert_allclose(normal, [1, 0], atol=1e-12)


def test_two_half_planes_have_no_contact() -> None:
    with pytest.raises(ValueError, match="two half-planes have no contact"):
        Contact.between(HalfPlane(), Pose.fixed(), HalfPlane(), Pose.fixed())
