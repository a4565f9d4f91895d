"""Free bodies with the origin off their centre of mass: conserved quantities, and the same centred bodies.

The origin's velocity in a state belongs to the pose at the start of the previous step.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dynamics.contact import Exact
from dynamics.systems import ContactSystem, Parameter, ParameterTable
from dynamics.systems.space import Body, Plane, SpatialMachine, SpatialPart, Sphere


def vector(values: np.ndarray) -> tuple[float, float, float]:
    x, y, z = map(float, values)
    return x, y, z


def random_body(rng: np.random.Generator) -> Body:
    """Draw a body of random mass and inertia, with its centre of mass up to metres off its origin."""
    A = rng.normal(size=(3, 3))
    second = A @ A.T
    inertia = np.trace(second) * np.eye(3) - second
    return Body(
        "b",
        None,
        float(rng.uniform(0.1, 5)),
        tuple(map(float, inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])),
        com=vector(rng.choice([0.01, 0.3, 3]) * rng.normal(size=3)),
        joint="free",
    )


def alone(body: Body, h: float, gravity=(0.0, 0.0, 0.0)) -> ContactSystem:
    return SpatialMachine((body,), gravity=gravity).system("alone", ParameterTable(), h=h, friction=None)


def flight(system: ContactSystem, x: np.ndarray, steps: int) -> tuple[np.ndarray, ...]:
    """Return states (steps, nx), energies (steps,) and linear momenta (steps, 3) of a motion from x."""
    book = system.energy_balance
    assert book is not None
    step = ca.Function("step", [system.x], [system.x_next_expr, system.x, book.energy, book.momentum])
    found = step.mapaccum(steps)(x)
    return found[1].full().T, found[2].full().ravel(), found[3].full().T


def start(rng: np.random.Generator, speed: float) -> np.ndarray:
    quaternion = rng.normal(size=4)
    quaternion /= np.linalg.norm(quaternion)
    return np.concatenate([rng.normal(size=3), quaternion, rng.normal(size=3), speed * rng.normal(size=3)])


def test_energy_is_never_gained_and_momentum_is_kept() -> None:
    """This holds for 100 bodies at up to 100 rad/s, steps from 1 ms to 1 s, over sixteen turns."""
    names = ["mass", *(f"inertia {k}" for k in range(6)), *(f"com {k}" for k in range(3)), "h"]
    p = ParameterTable([Parameter(name, 1.0, "1") for name in names])
    mass, *inertia, x, y, z, _ = (p[name] for name in names)
    body = Body("b", None, mass, tuple(inertia), com=(x, y, z), joint="free")
    machine = SpatialMachine((body,), gravity=(0.0, 0.0, 0.0))
    system = machine.system("alone", p, h=p["h"], friction=None)
    assert system.energy_balance is not None
    book = ca.vertcat(system.energy_balance.energy, system.energy_balance.momentum)
    fly = ca.Function("fly", [system.x, p.vector], [system.x_next_expr, book]).mapaccum(100)
    rng = np.random.default_rng(0)
    for k in range(100):
        own, h = random_body(rng), [1e-3, 0.01, 0.1, 1.0][k % 4]
        values = [own.mass, *own.inertia, *own.com, h]
        found = fly(start(rng, [1.0, 10.0, 100.0][k % 3]), ca.repmat(ca.DM(values), 1, 100))[1]
        energy, momentum = found.full()[0], found.full()[1:].T
        assert np.diff(energy).max() <= 1e-11 * energy[0], k
        size = np.sqrt(2 * energy[0] * float(own.mass))
        assert np.abs(momentum - momentum[0]).max() <= 1e-11 * size, k


def test_gravity_gives_its_impulse_and_nothing_else() -> None:
    rng, h = np.random.default_rng(1), 0.05
    body = random_body(rng)
    momentum = flight(alone(body, h, (0.0, 1.0, -9.81)), start(rng, 10.0), 50)[2]
    wanted = h * float(body.mass) * np.array([0.0, 1.0, -9.81])
    np.testing.assert_allclose(np.diff(momentum, axis=0), np.tile(wanted, (49, 1)), atol=1e-10)


def test_angular_momentum_is_lost_at_first_order_in_h() -> None:
    """R I omega in the world's axes is compared after a second of tumbling."""
    inertia, off = np.array([1.0, 2.0, 2.5]), []
    body = Body("b", None, 1.0, tuple(map(float, inertia)), com=(0.3, -0.2, 0.5), joint="free")
    first = np.array([0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0.5, 1.0, 0.8])
    for h in (0.02, 0.01, 0.005):
        x = flight(alone(body, h), first, round(1 / h) + 1)[0][-1]
        turned = Rotation.from_quat(x[3:7], scalar_first=True).apply(inertia * x[10:])
        off.append(np.linalg.norm(turned - inertia * first[10:]))
    assert off[0] < 0.01
    assert np.divide(off[:-1], off[1:]) == pytest.approx([2, 2], rel=0.05)


def test_with_contact_it_moves_as_the_same_body_about_its_centre() -> None:
    """A ball is thrown, lands plastically, slides and rolls; its origin is decimetres off its middle."""
    centre, h, friction, r = np.array([0.3, -0.2, 0.5]), 0.02, 0.4, 0.2
    own = Body("b", None, 2.0, (0.03, 0.04, 0.05), joint="free")

    def rolling(body: Body, at: np.ndarray) -> ContactSystem:
        parts = (
            SpatialPart("ball", "b", Sphere(r, vector(at))),
            SpatialPart("floor", "world", Plane()),
        )
        machine = SpatialMachine((body,), parts, (("ball", "floor"),))
        return machine.system("s", ParameterTable(), h=h, friction=friction)

    twin = rolling(own, np.array([0.02, 0, 0]))
    moved = rolling(replace(own, com=vector(centre)), centre + np.array([0.02, 0, 0]))
    turn, spin = Rotation.from_rotvec([0.2, 0.5, -0.3]), np.array([2.0, -4.0, 7.0])
    place, speed = np.array([0.1, 0.2, 0.3]), np.array([1.0, 0.5, -1.0])
    quaternion = turn.as_quat(scalar_first=True)
    before = turn * Rotation.from_rotvec(-h * spin)
    x = np.concatenate([place, quaternion, speed, spin])
    y = np.concatenate([place - turn.apply(centre), quaternion, speed - before.apply(np.cross(spin, centre)), spin])
    steps, pressed = [Exact().close(system) for system in (twin, moved)], 0
    for _ in range(60):
        (x, lam), (y, other) = (
            [np.array(part).ravel() for part in step.solve(at, [], step.p.values)[:2]]
            for step, at in zip(steps, (x, y), strict=True)
        )
        turn = Rotation.from_quat(y[3:7], scalar_first=True)
        np.testing.assert_allclose(y[:3] + turn.apply(centre), x[:3], atol=1e-7)
        np.testing.assert_allclose(y[[3, 4, 5, 6, 10, 11, 12]], x[[3, 4, 5, 6, 10, 11, 12]], atol=1e-6)
        np.testing.assert_allclose(other[0], lam[0], atol=1e-6)
        pressed += lam[0] > 0.01
    assert 5 < pressed < 60


def test_a_tree_on_such_a_body_tends_to_its_motion_at_first_order() -> None:
    """Half of h gives half the distance from the motion with much shorter steps."""
    bodies = (
        Body("b", None, 2.0, (0.03, 0.04, 0.05), com=(0.2, -0.1, 0.3), joint="free"),
        Body("arm", "b", 1.0, (0.01, 0.02, 0.02), com=(0.1, 0.0, 0.0), position=(0.0, 0.2, 0.1)),
    )
    first = np.array([0, 0, 0, 1, 0, 0, 0, 0.3, 0.1, 0.2, -0.1, 1.0, 2.0, -1.5, 3.0])

    def ended(h: float) -> np.ndarray:
        machine = SpatialMachine(bodies)
        system = machine.system("s", ParameterTable(), h=h, friction=None)
        return flight(system, first, round(0.2 / h) + 1)[0][-1]

    best = 2 * ended(0.2 / 4096) - ended(0.2 / 2048)
    off = [np.linalg.norm(ended(0.2 / n) - best) for n in (32, 64, 128)]
    assert np.divide(off[:-1], off[1:]) == pytest.approx([2, 2], rel=0.1)
