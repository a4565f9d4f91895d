"""Contacts of polygons are those of the Minkowski difference; areas are those of a fine grid."""

from __future__ import annotations

from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from scipy.spatial import ConvexHull

from dynamics.batch import BatchFunction
from dynamics.systems.shapes import Box, Capsule, Contact, Disc, HalfPlane, Polygon, Pose, Union
from dynamics.systems.shapes.areas import move_shape, shape_area
from dynamics.systems.shapes.polygon import vertex_pairs

SIZES = [(3, 8), (4, 4), (5, 3), (8, 6), (7, 5)]


def contacts(n: int, m: int) -> ca.Function:
    """Return the function from two polygons' vertices to gaps (1, k), normals (2, k) and points (2, k)."""
    a, b = ca.SX.sym("a", 2, n), ca.SX.sym("b", 2, m)
    one, other = (Polygon([s[:, i] for i in range(s.shape[1])]) for s in (a, b))
    found = [Contact.between(s, Pose.fixed(), t, Pose.fixed()) for s, t in vertex_pairs(one, other)]
    outputs = [ca.horzcat(*(getattr(c, what) for c in found)) for what in ("phi", "normal", "point")]
    return ca.Function("contacts", [a, b], outputs)


FUNCTIONS = {size: contacts(*size) for size in SIZES}


def polygon(rng: np.random.Generator, n: int) -> np.ndarray:
    """Return n vertices (2, n) on an ellipse, with angles at least a third of their even spacing apart."""
    spaces = 1 / 3 + rng.dirichlet(np.ones(n)) * n * 2 / 3
    angles = 2 * np.pi * (rng.random() + np.cumsum(spaces) / n)
    turn = rng.random() * np.pi
    c, s = np.cos(turn), np.sin(turn)
    ring = np.diag(rng.uniform(0.3, 1.0, 2)) @ np.array([np.cos(angles), np.sin(angles)])
    return np.array([[c, -s], [s, c]]) @ ring


def minkowski(a: np.ndarray, b: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the signed distance of the origin from all ``b - a``, and the normal out of b towards a."""
    cloud = (b[:, :, None] - a[:, None, :]).reshape(2, -1).T
    hull = ConvexHull(cloud)
    heights = hull.equations[:, 2]
    if heights.max() <= 0:
        return float(heights.max()), hull.equations[heights.argmax(), :2]
    ring = cloud[hull.vertices]
    best = np.inf, np.zeros(2)
    for p, q in pairwise([*ring, ring[0]]):
        share = np.clip(-p @ (q - p) / ((q - p) @ (q - p)), 0, 1)
        foot = p + share * (q - p)
        best = min(best, (float(np.hypot(*foot)), -foot), key=lambda pair: pair[0])
    return best[0], best[1] / best[0]


def nearest(size: tuple[int, int], a: np.ndarray, b: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    phi, normal, point = (np.array(out) for out in FUNCTIONS[size](a, b))
    i = int(phi.argmin())
    return float(phi[0, i]), normal[:, i], point[:, i]


def inside(vertices: np.ndarray, point: np.ndarray) -> float:
    """Return a point's largest height over a side of counterclockwise vertices (2, n), negative inside."""
    return float((normals(vertices) * (point[:, None] - vertices)).sum(axis=0).max())


def normals(vertices: np.ndarray) -> np.ndarray:
    """Return the sides' outward unit normals (2, n)."""
    along = np.roll(vertices, -1, axis=1) - vertices
    return np.array([along[1], -along[0]]) / np.hypot(*along)


def numbers(expression: ca.SX) -> np.ndarray:
    return np.array(ca.evalf(expression)).ravel()


def check(pairs: int, seed: int) -> None:
    rng, sides = np.random.default_rng(seed), 0
    for k in range(pairs):
        size = SIZES[k % len(SIZES)]
        a, b = polygon(rng, size[0]), polygon(rng, size[1])
        way = rng.standard_normal(2)
        a = a + (rng.uniform(1.8, 2.6) * way / np.hypot(*way))[:, None]
        distance, normal = minkowski(a, b)
        if distance < 1e-3:
            continue
        phi, n, point = nearest(size, a, b)
        assert phi == pytest.approx(distance, abs=1e-12)
        np.testing.assert_allclose(n, normal, atol=1e-9)
        assert abs(inside(a, point)) < 1e-12
        assert abs(inside(b, point - phi * n)) < 1e-12
        touching = a - (distance * normal)[:, None]
        assert abs(nearest(size, touching, b)[0]) < 1e-12
        deep = a - ((distance + 1e-4) * normal)[:, None]
        depth, into = minkowski(deep, b)
        phi, n, point = nearest(size, deep, b)
        assert depth - 1e-12 <= phi <= 1e-4
        assert abs(inside(deep, point)) < 1e-12
        if np.sum(np.hypot(*(np.hstack([deep, b]) - point[:, None])) < 1e-3) > 1:
            continue
        # A corner is in a side; between two corners the depth has only the bound above.
        if max(normals(a).T @ -normal) > 1 - 1e-9 or max(normals(b).T @ normal) > 1 - 1e-9:
            sides += 1
            assert phi == pytest.approx(depth, abs=1e-12)
            assert n @ into > 1 - 1e-9
    assert sides > 0.4 * pairs


@pytest.mark.cheap_cases("7", "9")
@pytest.mark.parametrize("seed", range(10))
def test_a_hundred_pairs_of_polygons_apart_in_touch_and_in_penetration(seed: int) -> None:
    check(100, seed)


@pytest.mark.costly
def test_ten_thousand_pairs_of_polygons() -> None:
    check(10000, 10)


ROUNDED = Polygon([(-0.2, -0.1), (0.3, -0.15), (0.25, 0.2), (-0.05, 0.3)], 0.05)
TEE = Union([Box((0.3, 0.1)), Polygon([(-0.1, -0.6), (0.1, -0.6), (0.1, -0.1), (-0.1, -0.1)])])
ELL = Union(
    [
        Polygon([(0, 0), (0.6, 0), (0.6, 0.2), (0, 0.2)]),
        Polygon([(0, 0.2), (0.2, 0.2), (0.2, 0.6), (0, 0.6)]),
    ]
)


SHAPES = {
    "rounded": ROUNDED,
    "box": Box((0.3, 0.2), 0.1),
    "capsule": Capsule((-0.2, 0), (0.3, 0.1), 0.1),
    "disc": Disc(0.2, (0.1, 0.3)),
    "tee": TEE,
    "ell": ELL,
}


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_areas_centres_and_moments_are_those_of_a_fine_grid(shape: Disc) -> None:
    step = 2e-3
    x, z = np.meshgrid(*[np.arange(-0.8, 0.8, step) + step / 2] * 2)
    at = np.vstack([x.ravel(), z.ravel()])
    p = ca.SX.sym("p", 2)
    gaps = [part.signed_distance(p, Pose.fixed())[0] for part in getattr(shape, "parts", (shape,))]
    found = ca.Function("gap", [p], [ca.densify(ca.mmin(ca.vertcat(*gaps)))])
    held = at[:, BatchFunction(found, backend="numpy")(at.T).ravel() < 0]
    whole = shape_area(shape)
    assert float(whole.area) == pytest.approx(held.shape[1] * step**2, rel=3e-3)
    np.testing.assert_allclose(numbers(whole.centre), held.mean(axis=1), atol=1e-3)
    spread = ((held - held.mean(axis=1)[:, None]) ** 2).sum(axis=0).mean()
    assert float(whole.gyration) == pytest.approx(spread, rel=5e-3)
    put = shape_area(move_shape(shape, (0.3, -0.2)))
    assert float(put.gyration) == pytest.approx(float(whole.gyration), rel=1e-12)
    np.testing.assert_allclose(numbers(put.centre - whole.centre), [0.3, -0.2], atol=1e-12)


def test_a_tee_and_an_ell_by_hand() -> None:
    """The T is a bar of 0.6 x 0.2 at 0 and a stem of 0.2 x 0.5 at -0.35, the L legs of 0.6 x 0.2 and 0.2 x 0.4."""
    tee, ell = shape_area(TEE), shape_area(ELL)
    assert float(tee.area) == pytest.approx(0.22)
    np.testing.assert_allclose(numbers(tee.centre), [0, -0.35 * 0.1 / 0.22], atol=1e-14)
    bar, stem = 0.12 * (0.6**2 + 0.2**2) / 12, 0.1 * (0.2**2 + 0.5**2) / 12
    between = 0.35**2 * 0.12 * 0.1 / 0.22
    assert float(tee.gyration) == pytest.approx((bar + stem + between) / 0.22, rel=1e-12)
    middle = (0.12 * 0.3 + 0.08 * 0.1) / 0.2, (0.12 * 0.1 + 0.08 * 0.4) / 0.2
    np.testing.assert_allclose(numbers(ell.centre), middle, rtol=1e-12)


def test_corners_inside_a_union_make_no_contacts() -> None:
    """A T has 8 corners, of which 2 point inwards; an L has 6, of which 1."""
    floor = HalfPlane()
    for union, count in ((TEE, 6), (ELL, 5)):
        found = vertex_pairs(union, floor)
        places = {tuple(np.round(numbers(s.centre), 9)) for s, _ in found}  # type: ignore[attr-defined]
        assert len(found) == len(places) == count


def test_a_box_is_a_polygon_of_its_corners() -> None:
    box, same = (
        Box((0.3, 0.2), 0.05),
        Polygon([(0.3, 0.2), (-0.3, 0.2), (-0.3, -0.2), (0.3, -0.2)], 0.05),
    )
    p, q = ca.SX.sym("p", 2), ca.SX.sym("q", 3)
    both = [ca.vertcat(*shape.signed_distance(p, Pose(q[:2], q[2]))) for shape in (box, same)]
    points = np.random.default_rng(0).uniform(-1, 1, (500, 5))
    for engine in ("numpy", "c"):
        one, other = BatchFunction(ca.Function("f", [p, q], both), backend=engine)(points[:, :2], points[:, 2:])
        np.testing.assert_allclose(one, other, atol=1e-14)


def test_the_gradient_is_the_normal_by_complex_steps_and_the_engines_agree() -> None:
    """Outside a polygon the gap to a disc at p has d phi / d p = n, in NumPy and in C."""
    p, q = ca.SX.sym("p", 2), ca.SX.sym("q", 3)
    contact = Contact.between(Disc(0.1), Pose(p, ca.SX(0)), ROUNDED, Pose(q[:2], q[2]))
    slope = ca.gradient(contact.phi, p)
    f = ca.Function("f", [p, q], [contact.phi, contact.normal, slope])
    rng = np.random.default_rng(2)
    at, pose = rng.uniform(-1, 1, (400, 2)), rng.uniform(-0.5, 0.5, (400, 3))
    phi, normal, found = BatchFunction(f, backend="numpy")(at, pose)
    np.testing.assert_allclose(found[phi.ravel() > -0.1], normal[phi.ravel() > -0.1], atol=1e-12)
    for one, other in zip(BatchFunction(f, backend="c")(at, pose), (phi, normal, found), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-13)
    step = 1e-6
    for i in range(2):
        ahead, back = (
            np.array(BatchFunction(f, backend="numpy")(at + s * np.eye(2)[i], pose)[0]) for s in (step, -step)
        )
        apart = phi.ravel() > -0.09
        np.testing.assert_allclose(((ahead - back) / (2 * step)).ravel()[apart], normal[apart, i], atol=1e-4)


@pytest.mark.parametrize(
    ("vertices", "radius", "sentence"),
    [
        ([(0, 0), (1, 0)], 0, "must be at least three points"),
        ([(0, 0), (1, 0), (1, 0)], 0, "two equal vertices"),
        ([(0, 0), (1, 1), (2, 2)], 0, "has no area"),
        ([(0, 0), (1, 1), (1, 0), (0, 1)], 0, "has sides that cross"),
        ([(0, 0), (2, 0), (2, 2), (1, 0.5)], 0, "is not convex at vertex 3; write it as a Union"),
        ([(0, 0), (1, 0), (2, 0), (1, 1)], 0, "vertex 1 lies on the line"),
        ([(0, 0), (1, 0), (1, 1), (0, 1)], 0.6, "rounded by 0.6 m; expected less than 0.5 m"),
        ([(0, 0), (1, 0), ("a", 1)], 0, "must be a number"),
    ],
)
def test_what_is_no_convex_polygon_is_refused(
    vertices: list[tuple[float, float]], radius: float, sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence.replace("(", r"\(")):
        Polygon(vertices, radius)
    if radius == 0 and len(vertices) > 2 and sentence != "must be a number":
        with pytest.raises(ValueError, match=sentence):
            Polygon(vertices[::-1] if "vertex" not in sentence else vertices)
