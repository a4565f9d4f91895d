"""Signed distances agree with brute-force nearest points, Jacobians with differences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from dynamics.systems.shapes import Box, Capsule, Contact, Disc, HalfPlane, Pose, Shape

RADIUS = 0.1
HALF = np.array([0.5, 0.3])
END = np.array([0.3, -0.2])


@dataclass(frozen=True)
class Case:
    """A body with the pose q[2:5] against a disc with centre q[:2] and angle q[5]."""

    shape: Shape
    surface: Callable[[], np.ndarray]
    """Return points of the body's surface in its frame, (n, 2), at most 1e-3 apart."""
    inside: Callable[[np.ndarray], bool]
    smooth: Callable[[np.ndarray], bool]
    """Return whether phi is differentiable around a centre given in the body's frame."""


def circle(centre: np.ndarray, radius: float, start: float, end: float) -> np.ndarray:
    angle = np.linspace(start, end, 3000)
    return centre + radius * np.column_stack((np.cos(angle), np.sin(angle)))


def box_surface(corner: float) -> np.ndarray:
    inner = HALF - corner
    pieces = []
    for sign in (-1, 1):
        x, z = np.linspace(-inner[0], inner[0], 1500), np.linspace(-inner[1], inner[1], 1500)
        pieces += [np.column_stack((x, 0 * x + sign * HALF[1]))]
        pieces += [np.column_stack((0 * z + sign * HALF[0], z))]
    for i, signs in enumerate(([1, 1], [-1, 1], [-1, -1], [1, -1])):
        pieces.append(circle(inner * signs, corner, i * np.pi / 2, (i + 1) * np.pi / 2))
    return np.vstack(pieces)


def box_case(corner: float) -> Case:
    def inside(p: np.ndarray) -> bool:
        d = np.abs(p) - HALF + corner
        return bool(np.hypot(*np.maximum(d, 0)) < corner or d.max() < 0)

    def smooth(p: np.ndarray) -> bool:
        d = np.abs(p) - HALF + corner
        if d.min() > 0:
            return bool(np.hypot(*d) > 1e-2)
        same_side = d.max() > 0 or abs(d[0] - d[1]) > 1e-2
        return bool(same_side and abs(p[np.argmax(d)]) > 1e-2)

    return Case(
        Box(tuple(HALF), corner),
        lambda: box_surface(corner),
        inside,
        smooth,
    )


def capsule_surface() -> np.ndarray:
    length = np.hypot(*END)
    along = END / length
    across = np.array([-along[1], along[0]])
    share = np.linspace(0, 1, 1500)[:, None] * END
    return np.vstack(
        [
            share + 0.15 * across,
            share - 0.15 * across,
            circle(np.zeros(2), 0.15, 0, 2 * np.pi),
            circle(END, 0.15, 0, 2 * np.pi),
        ]
    )


def to_segment(p: np.ndarray) -> float:
    share = np.clip(p @ END / (END @ END), 0, 1)
    return float(np.hypot(*(p - share * END)))


def outer(points: np.ndarray) -> np.ndarray:
    """Return the points that are not inside another piece of the capsule."""
    return points[[to_segment(p) > 0.15 - 1e-9 for p in points]]


CASES = {
    "half-plane": Case(
        HalfPlane(),
        lambda: np.column_stack((np.linspace(-2.5, 2.5, 8000), np.zeros(8000))),
        lambda p: bool(p[1] < 0),
        lambda p: True,
    ),
    "disc": Case(
        Disc(0.4),
        lambda: circle(np.zeros(2), 0.4, 0, 2 * np.pi),
        lambda p: bool(np.hypot(*p) < 0.4),
        lambda p: bool(np.hypot(*p) > 1e-2),
    ),
    "capsule": Case(
        Capsule((0.0, 0.0), tuple(END), 0.15),
        lambda: outer(capsule_surface()),
        lambda p: to_segment(p) < 0.15,
        lambda p: to_segment(p) > 1e-2,
    ),
    "box": box_case(0.0),
    "rounded box": box_case(0.12),
}
SURFACES = {name: case.surface() for name, case in CASES.items()}


def functions(case: Case) -> dict[str, ca.Function]:
    q = ca.SX.sym("q", 6)
    disc, body = Pose(q[:2], q[5]), Pose(q[2:4], q[4])
    contact = Contact.between(Disc(RADIUS), disc, case.shape, body)
    J_n, J_t = contact.jacobians(q)
    outputs = {
        "phi": contact.phi,
        "normal": contact.normal,
        "tangent": contact.tangent,
        "point": contact.point,
        "J_n": ca.densify(J_n),
        "J_t": ca.densify(J_t),
        "gradient": ca.densify(ca.jacobian(contact.phi, q)),
        "on_disc": disc.to_local(contact.point),
        "on_body": body.to_local(contact.point),
        "bend": ca.densify(ca.jacobian(ca.vertcat(contact.normal, contact.point), q)),
    }
    return {name: ca.Function(name, [q], [out]) for name, out in outputs.items()}


FUNCTIONS = {name: functions(case) for name, case in CASES.items()}
poses = st.tuples(*[st.floats(-1, 1)] * 2, st.floats(-3, 3), st.floats(-3, 3))
centres = st.tuples(*[st.floats(-0.9, 0.9)] * 2)
every_case = pytest.mark.parametrize("name", CASES)


def turn(angle: float, p: np.ndarray) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return p @ np.array([[c, -s], [s, c]])


def configuration(pose: tuple[float, ...], centre: tuple[float, float]) -> np.ndarray:
    x, z, angle, own_angle = pose
    position = np.array([x, z])
    return np.array([*(turn(angle, np.array(centre)) + position), *position, angle, own_angle])


@every_case
@given(pose=poses, centre=centres)
def test_distance_and_nearest_points_against_all_points_of_the_surface(
    name: str, pose: tuple[float, ...], centre: tuple[float, float]
) -> None:
    case, f = CASES[name], FUNCTIONS[name]
    local = np.array(centre)
    assume(case.smooth(local))
    q = configuration(pose, centre)
    surface = turn(pose[2], SURFACES[name]) + q[2:4]
    apart = np.hypot(*(surface - q[:2]).T)
    distance = -apart.min() if case.inside(local) else apart.min()
    phi, normal, point = (np.array(f[key](q)).ravel() for key in ("phi", "normal", "point"))
    # Surface points are up to 1e-3 apart, so that the nearest is off by up to half of that.
    assert phi.item() == pytest.approx(distance - RADIUS, abs=5e-4)
    assert np.hypot(*normal) == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(point, q[:2] - RADIUS * normal, atol=1e-12)
    foot = point - phi * normal
    assert np.hypot(*(surface - foot).T).min() < 6e-4
    tangent = np.array(f["tangent"](q)).ravel()
    np.testing.assert_allclose(tangent, [normal[1], -normal[0]])


@every_case
@given(pose=poses, centre=centres)
def test_normal_and_jacobians_against_central_differences(
    name: str, pose: tuple[float, ...], centre: tuple[float, float]
) -> None:
    case, f = CASES[name], FUNCTIONS[name]
    assume(case.smooth(np.array(centre)))
    q = configuration(pose, centre)
    # Where a side meets a corner the curvature jumps by up to 1e2, which shows as eps times that.
    eps = 1e-7
    slopes = np.array([float(f["phi"](q + e) - f["phi"](q - e)) for e in eps * np.eye(6)])
    slopes /= 2 * eps
    J_n, J_t = (np.array(f[key](q)).ravel() for key in ("J_n", "J_t"))
    normal, tangent = (np.array(f[key](q)).ravel() for key in ("normal", "tangent"))
    np.testing.assert_allclose(slopes[:2], normal, atol=5e-6)
    np.testing.assert_allclose(J_n, slopes, atol=5e-6)
    np.testing.assert_allclose(np.array(f["gradient"](q)).ravel(), J_n, atol=1e-10)

    on_disc, on_body = (np.array(f[key](q)).ravel() for key in ("on_disc", "on_body"))

    def apart(at: np.ndarray) -> np.ndarray:
        """Return the vector between the two material points that coincide in the contact point at q."""
        return at[:2] + turn(at[5], on_disc) - at[2:4] - turn(at[4], on_body)

    slip = np.array([(apart(q + e) - apart(q - e)) / (2 * eps) for e in eps * np.eye(6)])
    np.testing.assert_allclose(J_t, slip @ tangent, atol=1e-7)
    np.testing.assert_allclose(J_n, slip @ normal, atol=1e-7)


@pytest.mark.parametrize("name", ["box", "rounded box"])
@pytest.mark.parametrize(
    "centre",
    [(0.5, 0.3), (0.5, 0.0), (0.0, 0.3), (0.0, 0.1), (0.6, 0.0), (0.0, -0.4), (0.38, 0.18), (0.38, 0.5), (0.0, 0.0)],
)
def test_box_is_finite_on_every_seam(name: str, centre: tuple[float, float]) -> None:
    """Seams are corners, sides and axes, where the pieces of the distance meet."""
    f = FUNCTIONS[name]
    q = configuration((0.0, 0.0, 0.0, 0.0), centre)
    for key in ("phi", "normal", "J_n", "J_t", "gradient", "bend"):
        assert np.isfinite(np.array(f[key](q))).all(), key
    assert np.hypot(*np.array(f["normal"](q)).ravel()) == pytest.approx(1)


@pytest.mark.parametrize(
    ("centre", "normal", "phi"),
    [
        ((0.8, 0.1), (1, 0), 0.2),
        ((-0.8, 0.1), (-1, 0), 0.2),
        ((0.1, 0.5), (0, 1), 0.1),
        ((0.1, -0.5), (0, -1), 0.1),
        ((0.8, 0.7), (0.6, 0.8), 0.4),
        ((-0.8, -0.7), (-0.6, -0.8), 0.4),
        ((0.45, 0.0), (1, 0), -0.15),
        ((0.45, 0.2), (1, 0), -0.15),
        ((-0.1, -0.2), (0, -1), -0.2),
    ],
)
def test_sharp_box_by_hand(centre: tuple[float, float], normal: tuple[float, float], phi: float) -> None:
    f = FUNCTIONS["box"]
    q = configuration((0.0, 0.0, 0.0, 0.0), centre)
    assert float(f["phi"](q)) == pytest.approx(phi)
    assert np.array(f["normal"](q)).ravel().tolist() == pytest.approx(normal)


def test_disc_rolls_on_a_floor_without_slip() -> None:
    """A wheel that turns forward about +y moves forward by its radius times its angle."""
    q = ca.SX.sym("q", 3)
    wheel = Pose(q[:2], q[2])
    _, J_t = Contact.between(Disc(RADIUS), wheel, HalfPlane(), Pose.fixed()).jacobians(q)
    slip = ca.Function("slip", [q], [J_t @ ca.DM([RADIUS * 2.0, 0.0, 2.0])])
    assert float(slip([0.0, RADIUS, 0.3])) == pytest.approx(0, abs=1e-15)
