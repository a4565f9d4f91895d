"""Steps of scenes agree with hand computations, mirror images, and energy and momentum balances."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact, Randomized
from dynamics.systems import ContactSystem, Parameter, ParameterTable
from ocp import Problem, Scaling, Solution, solve
from problems.scenes import Body, Box, Disc, HalfPlane, Obstacle, Pusher, Scene

NOTHING = ParameterTable()
LAWS = [Exact(), Barrier(mu=1e-4), Adaptive(sigma=0.02), Randomized(sigma=0.02)]
by_law = pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)


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


@pytest.mark.cheap_cases("barrier")
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
