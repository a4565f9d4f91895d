"""Scenes agree with sampled geometry, closed forms, mirror images, and energy and momentum balances."""

from __future__ import annotations

import functools
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact, Randomized
from dynamics.systems import ContactSystem, Parameter, ParameterTable
from dynamics.systems.shapes import Shape
from ocp import Problem, Scaling, Solution, solve
from problems.scenes import Body, Box, Capsule, Disc, HalfPlane, Obstacle, Pusher, Scene
from problems.scenes.things import Thing
from tests.examples import settings

NOTHING = ParameterTable()
LAWS = [Exact(), Barrier(mu=1e-4), Adaptive(sigma=0.02), Randomized(sigma=0.02)]
by_law = pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
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


@pytest.mark.cheap_cases("disc-disc", "disc-capsule", "rounded-disc", "capsule-disc")
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


def step(system: ContactSystem, law: ContactLaw, x: object, u: object, **values: float):
    """Return the next state, and the impulses along normals and tangents."""
    closed = law.close(system)
    p = closed.p.pack(values)
    x_next, lam, _, error = (np.array(v) for v in closed.solve(x, u, p))
    assert error.max() < 1e-8
    # A law that averages has blocks of multipliers, whose mean moves the system.
    mean = lam.reshape(-1, system.nlam).mean(axis=0)
    sums = system.forces
    assert sums is not None
    given = [system.lam, system.parameters.vector]
    told = ca.Function("told", given, [sums.normal, sums.tangential])
    p = system.parameters.pack(values)
    return x_next.ravel(), *(np.array(v).ravel() for v in told(mean, p))


def wedged(friction: Any, p: ParameterTable, cone: Any = "linearised") -> ContactSystem:
    """Return the system of a disc pushed along a wall, with friction at the hand and maybe the wall."""
    return Scene(
        [
            Pusher("hand", Disc(0.1), at=(-0.3, 0.1), stiffness=50.0),
            Body("object", Disc(0.2), at=(0.0, 0.0), inertia=0.02),
            Obstacle("wall", HalfPlane(), at=(0.0, -0.2)),
        ],
        friction=friction,
    ).quasi_dynamic("wedged", p, h=0.1, cone=cone)


@pytest.mark.cheap_cases("second-order-barrier", "edges-barrier")
@by_law
@pytest.mark.parametrize("cone", ["linearised", "second-order", "edges"])
def test_a_smooth_contact_beside_a_rough_one_drags_nothing(law: ContactLaw, cone: str) -> None:
    """Friction of zero is a number or a parameter's value; a positive value does drag."""
    x, u = [0, 0, 0, -0.3, 0.1], [-0.1, 0.0]
    p = ParameterTable([Parameter("wall", 0.0)])
    hand = {("hand", "object"): 0.5}
    number, drag = step(wedged(hand, NOTHING, cone), law, x, u), None
    for wall, rough in ((0.0, False), (0.3, True)):
        symbol = {**hand, ("object", "wall"): p["wall"]}
        x_next, normal, drag = step(wedged(symbol, p, cone), law, x, u, wall=wall)
        assert normal[2] > 0.05
        assert (abs(drag[2]) > 1e-3) == rough
        if not rough and cone != "edges":
            np.testing.assert_allclose(x_next, number[0], atol=1e-7)
    assert drag is not None and np.abs(number[2][1:]).max() == 0
    assert abs(number[2][0]) > 1e-3


def test_a_smooth_contact_has_its_normal_pair_alone() -> None:
    system = wedged({("hand", "object"): 0.5}, NOTHING)
    kinds = [(pair.kind, pair.contact) for pair in system.pairs]
    normals = [("normal", 0), ("normal", 1), ("normal", 2)]
    assert kinds == [*normals, ("friction", 0), ("friction", 0), ("slip", 0)]
    assert [signal.name for signal in system.contacts[:3]] == [
        "hand on object",
        "hand on wall",
        "object on wall",
    ]
    assert wedged(0.0, NOTHING).nlam == 3 and wedged(0.0, NOTHING).forces is None


@pytest.mark.costly_cases("exact")
@pytest.mark.parametrize("law", LAWS[:3], ids=lambda law: law.name)
def test_a_mirrored_scene_moves_in_mirror_image(law: ContactLaw) -> None:
    def made(side: float) -> ContactSystem:
        return Scene(
            [
                Pusher("hand", Disc(0.1), at=(-0.3, side * 0.1), stiffness=50.0),
                Body("object", Box((0.2, 0.2), 0.05), at=(0.0, 0.0), inertia=0.02),
                Obstacle("post", Disc(0.1), at=(0.3, side * 0.2)),
            ],
            friction=0.3,
        ).quasi_dynamic("mirror", NOTHING, h=0.1)

    flip = np.array([1, -1, -1, 1, -1])
    up, normal, drag = step(made(1), law, [0, 0, 0, -0.3, 0.1], [0.1, 0.15])
    down, same, back = step(made(-1), law, [0, 0, 0, -0.3, -0.1], [0.1, -0.15])
    np.testing.assert_allclose(down, flip * up, atol=1e-7)
    np.testing.assert_allclose(same, normal, atol=1e-7)
    np.testing.assert_allclose(back, -drag, atol=1e-7)
    assert np.abs(up[:3]).max() > 0.005 and abs(drag[0]) > 1e-3


@pytest.mark.costly
def test_a_mirrored_task_has_the_mirrored_plan() -> None:
    """The plan goes past a post on one side or on the other."""

    def planned(side: float) -> Solution:
        scene = Scene(
            [
                Pusher("hand", Disc(0.1), at=(-0.35, 0.0), stiffness=50.0),
                Body("object", Disc(0.2), at=(0.0, 0.0), inertia=0.02),
                Obstacle("post", Disc(0.1), at=(0.45, -side * 0.1)),
            ],
            friction={("hand", "object"): 0.3},
        )
        system = scene.quasi_dynamic("mirror", NOTHING, h=0.05)
        du = ca.SX.sym("du", 2)
        off = scene.coordinates_of("object", system.x)[:2] - ca.DM([0.6, side * 0.2])
        return solve(
            Problem(
                "mirror",
                system,
                20,
                stage_cost=0.1 * ca.sumsqr(du),
                terminal_cost=10 * ca.sumsqr(off),
                x0=scene.at_rest(system),
                parameters=NOTHING,
                du=du,
                u_before=scene.hold,
                scaling=Scaling(0.5, 0.1, 0.5, 0.5),
            ),
            Exact(),
        )

    up, down = planned(1), planned(-1)
    assert up.success and down.success and up.cost == pytest.approx(down.cost, rel=1e-6)
    one, other = (found.data["x"].values[0] for found in (up, down))
    np.testing.assert_allclose(other, one * [1, -1, -1, 1, -1], atol=1e-4)
    assert np.ptp(one[:, 1]) > 0.1


def test_a_quasi_dynamic_push_by_hand() -> None:
    """In contact ``M do / h = h K (u - a+) = lam``, as for springs in series."""
    M, K, h, told = 2.0, 50.0, 0.1, 0.05
    system = Scene(
        [
            Pusher("hand", Disc(0.1), at=(-0.3, 0.0), stiffness=K),
            Body("object", Disc(0.2), at=(0.0, 0.0), mass=M),
        ],
        friction=0.5,
    ).quasi_dynamic("push", NOTHING, h=h)
    x_next, normal, _ = step(system, Exact(), [0, 0, -0.3, 0], [-0.3 + told, 0])
    gone = told * h * K / (M / h + h * K)
    np.testing.assert_allclose(x_next, [gone, 0, -0.3 + gone, 0], atol=1e-9)
    assert normal[0] == pytest.approx(M * gone / h)


def moving(friction: float, rail: bool = False) -> ContactSystem:
    along = (0.6, 0.8) if rail else None
    return Scene(
        [
            Body("one", Box((0.2, 0.2), 0.05), at=(0.0, 0.0), mass=1.5, inertia=0.07),
            Body("two", Disc(0.2), at=(0.41, 0.1), mass=0.5, inertia=0.01),
            Pusher("cart", Disc(0.1), at=(0.0, -0.35), mass=1.0, axis=along),
        ],
        friction=friction,
    ).time_stepping("moving", NOTHING, h=0.01)


def unbalanced(system: ContactSystem, x, u, x_next) -> list[np.ndarray]:
    """Return the gain of energy less work, and the gain of momentum less external impulses."""
    book, closed = system.energy_balance, Exact().close(system)
    assert book is not None
    lam = closed.solve(x, u, closed.p.values)[1]
    given = [system.x, system.u, system.x_next, system.lam]
    told = ca.Function("told", [system.x], [book.energy, book.momentum])
    outside = ca.Function("outside", given, [book.work, book.external])(x, u, x_next, lam)
    parts = zip(told(x), told(x_next), outside, strict=True)
    return [np.array(after - before - flow) for before, after, flow in parts]


@pytest.mark.costly
@pytest.mark.parametrize("friction", [0.0001, 0.6])
@pytest.mark.parametrize("rail", [False, True])
def test_momentum_is_kept_and_energy_only_lost(friction: float, rail: bool) -> None:
    system = moving(friction, rail)
    cart = [0.0] if rail else [0.0, -0.35]
    q = [0.0, 0.0, 0.0, 0.41, 0.1, 0.0, *cart]
    v = [1.0, -1.0, 0.3, -2.0, 0.5, 4.0, *([0.8] if rail else [0.5, 1.0])]
    x = np.array([*q, *v])
    u = np.array([3.0] if rail else [3.0, -1.0])
    x_next, normal, _ = step(system, Exact(), x, u)
    assert normal.max() > 0.1
    energy, momentum = unbalanced(system, x, u, x_next)
    np.testing.assert_allclose(momentum, 0, atol=1e-10)
    assert energy.item() < -0.01
    if not rail:
        # The motor is the only external force.
        m = np.array([1.5, 0.5, 1.0])[:, None]
        places = [[8, 9], [11, 12], [14, 15]]
        gained = (m * (x_next[places] - x[places])).sum(axis=0)
        np.testing.assert_allclose(gained, 0.01 * u, atol=1e-10)
