"""Planar chains: equations of motion from the Lagrangian, energy and momentum, and the two machines."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.systems.planar.chain import Chain
from dynamics.systems.planar.links import Link
from problems.bodies.half_cheetah.machine import half_cheetah
from problems.bodies.hopper.machine import hopper

PENDULUM = (
    Link("upper", None, 1.3, 0.04, com=(0.1, -0.2), anchor=(0.3, 0.1), offset=0.2),
    Link("lower", "upper", 0.7, 0.03, com=(0.0, -0.15), anchor=(0.0, -0.4), spring=3.0),
)
CRANE = (
    Link("cart", None, 2.0, 0.1, joint="slide", gear=5.0, damping=0.3, limits=(-1.0, 1.0)),
    Link("arm", "cart", 1.0, 0.05, com=(0.2, -0.3), offset=0.4, gear=2.0),
    Link(
        "piston",
        "arm",
        0.5,
        0.02,
        com=(0.05, 0.0),
        anchor=(0.1, -0.5),
        joint="slide",
        axis=(0.6, -0.8),
        spring=20.0,
        offset=0.3,
    ),
    Link("hook", "piston", 0.3, 0.01, com=(0.0, -0.1), anchor=(0.0, -0.05)),
    Link("ball", None, 0.4, 0.02, com=(0.03, 0.01), joint="free", damping=0.2),
)
CHAINS = {
    "pendulum": Chain(PENDULUM),
    "crane": Chain(CRANE, gravity=1.7),
    "hopper": hopper().tree(),
    "half-cheetah": half_cheetah().tree(),
}
every_chain = pytest.mark.parametrize("chain", CHAINS.values(), ids=CHAINS)


def state(chain: Chain, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return tuple(rng.normal(size=(3, chain.nq)))


def evaluator(chain: Chain, build: Callable[[ca.SX, ca.SX], ca.SX]) -> Callable[..., np.ndarray]:
    q, v = ca.SX.sym("q", chain.nq), ca.SX.sym("v", chain.nq)
    function = ca.Function("f", [q, v], [build(q, v)])
    return lambda at_q, at_v: np.array(function(at_q, at_v))


def lagrangian_from_positions(chain: Chain, links: tuple[Link, ...], gravity: float):
    """Return the Lagrangian L(q, v) from the positions of the centres of mass, by differences."""
    q = ca.SX.sym("q", chain.nq)
    centres = ca.Function("centres", [q], [ca.vertcat(*(chain.position(q, k.name, k.com) for k in links))])
    angles = ca.Function("angles", [q], [ca.vertcat(*(chain.pose(q, k.name).angle for k in links))])
    mass = np.array([float(k.mass) for k in links])
    inertia = np.array([float(k.inertia) for k in links])

    def lagrangian(at: np.ndarray, v: np.ndarray) -> float:
        eps = 1e-4
        velocity = (np.array(centres(at + eps * v)) - np.array(centres(at - eps * v))) / (2 * eps)
        omega = (np.array(angles(at + eps * v)) - np.array(angles(at - eps * v))) / (2 * eps)
        height = np.array(centres(at)).reshape(-1, 2)[:, 1]
        speed2 = (velocity.reshape(-1, 2) ** 2).sum(axis=1)
        return float(mass @ (speed2 / 2 - gravity * height) + inertia @ omega.ravel() ** 2 / 2)

    return lagrangian


def test_kinematics_of_two_links_by_hand() -> None:
    """Angles are positive from z towards x: at pi/2 a link that hung down points backwards."""
    chain = Chain(
        [
            Link("upper", None, 1.0, 1.0, anchor=(1.0, 2.0)),
            Link("lower", "upper", 1.0, 1.0, anchor=(0.0, -0.5), offset=np.pi / 4),
        ]
    )
    q = ca.SX.sym("q", 2)
    tip = ca.Function("tip", [q], [chain.position(q, "lower", (0.0, -0.3))])
    at = np.array(tip([np.pi / 2, -np.pi / 4])).ravel()
    np.testing.assert_allclose(at, [1.0 - 0.5 - 0.3, 2.0], atol=1e-15)
    angle = ca.Function("angle", [q], [chain.pose(q, "lower").angle])
    assert float(angle([0.3, 0.2])) == pytest.approx(np.pi / 4 + 0.5)


def test_coordinates_motors_and_limits_follow_the_order_of_the_links() -> None:
    """This also holds if a child is declared before its parent."""
    chain = Chain((CRANE[1], *CRANE[2:], CRANE[0]))
    assert [c.name for c in chain.coordinates] == [
        "arm",
        "piston",
        "hook",
        "ball_x",
        "ball_z",
        "ball_angle",
        "cart",
    ]
    assert [c.unit for c in chain.coordinates] == ["rad", "m", "rad", "m", "m", "rad", "m"]
    assert chain.velocities[1].unit == "m/s"
    assert chain.limits == [(6, -1.0, 1.0)]
    assert chain.actuated == ("arm", "cart")
    B = np.zeros((7, 2))
    B[0, 0], B[6, 1] = 2.0, 5.0
    np.testing.assert_array_equal(np.array(ca.DM(chain.B)), B)
    ordered = CHAINS["crane"]
    q = np.random.default_rng(2).normal(size=7)
    order = [1, 2, 3, 4, 5, 6, 0]
    M = evaluator(chain, lambda q, v: chain.mass(q))(q[order], np.zeros(7))
    reference = evaluator(ordered, lambda q, v: ordered.mass(q))(q, np.zeros(7))
    np.testing.assert_allclose(M, reference[np.ix_(order, order)], atol=1e-14)


@pytest.mark.cheap_cases("pendulum")
@every_chain
@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10_000))
def test_mass_is_the_hessian_of_kinetic_energy_and_positive_definite(chain: Chain, seed: int) -> None:
    q, v, _ = state(chain, seed)
    M = evaluator(chain, lambda q, v: chain.mass(q))(q, v)
    np.testing.assert_array_equal(M, M.T)
    assert np.linalg.eigvalsh(M).min() > 0
    hessian = evaluator(chain, lambda q, v: ca.hessian(chain.kinetic(q, v), v)[0])(q, v)
    np.testing.assert_allclose(M, hessian, atol=1e-12)


@pytest.mark.parametrize(
    ("links", "gravity"),
    [(PENDULUM, 9.81), (CRANE, 1.7), (hopper().links, 9.81), (half_cheetah().links, 9.81)],
    ids=CHAINS,
)
def test_equations_of_motion_against_differences_of_the_lagrangian(links, gravity) -> None:
    """d/dt dL/dv - dL/dq is from a Lagrangian that shares only the kinematics with the recursions."""
    chain = Chain(links, gravity)
    lagrangian = lagrangian_from_positions(chain, links, gravity)
    q, v, a = state(chain, 3)
    eps, unit = 1e-3, np.eye(chain.nq)

    def momentum(at: np.ndarray, speed: np.ndarray) -> np.ndarray:
        # L is quadratic in v: its central difference there is exact, whatever the step.
        return np.array([(lagrangian(at, speed + e) - lagrangian(at, speed - e)) / 2 for e in unit])

    later, earlier = ((q + s * eps * v, v + s * eps * a) for s in (1, -1))
    rate = (momentum(*later) - momentum(*earlier)) / (2 * eps)
    slope = [(lagrangian(q + eps * e, v) - lagrangian(q - eps * e, v)) / (2 * eps) for e in unit]
    force = evaluator(chain, lambda q, v: chain.inverse_dynamics(q, v, ca.DM(a)))(q, v).ravel()
    np.testing.assert_allclose(force, rate - slope, atol=2e-4 * np.abs(force).max())


@every_chain
def test_bias_mass_and_potential_are_those_of_one_lagrangian(chain: Chain) -> None:
    q, v, a = state(chain, 4)
    whole = evaluator(chain, lambda q, v: chain.inverse_dynamics(q, v, ca.DM(a)))(q, v)
    parts = evaluator(chain, lambda q, v: chain.mass(q) @ ca.DM(a) + chain.bias(q, v))(q, v)
    np.testing.assert_allclose(whole, parts, atol=1e-11)
    at_rest = evaluator(chain, lambda q, v: chain.bias(q, 0 * v) - chain.spring(q))(q, v)
    slope = evaluator(chain, lambda q, v: ca.gradient(chain.potential(q), q))(q, v)
    np.testing.assert_allclose(at_rest, slope, atol=1e-12)
    # Coriolis forces do no work beyond the change of M: v' (bias - gravity) = v' dM/dt v / 2.
    power = evaluator(
        chain,
        lambda q, v: ca.dot(v, chain.bias(q, v) - chain.bias(q, 0 * v)) - ca.jtimes(chain.kinetic(q, v), q, v),
    )(q, v)
    assert power.item() == pytest.approx(0, abs=1e-11)


@every_chain
def test_energy_drift_falls_with_the_step_at_first_order(chain: Chain) -> None:
    """The motion is by semi-implicit Euler without damping and contact, over 0.08 s."""
    q, v = ca.SX.sym("q", chain.nq), ca.SX.sym("v", chain.nq)
    acceleration = ca.Function("a", [q, v], [ca.solve(chain.mass(q), chain.spring(q) - chain.bias(q, v))])
    energy = ca.Function("e", [q, v], [chain.energy(q, v)])
    drifts = []
    for n in (100, 200, 400):
        at, speed, _ = (ca.DM(value) for value in state(chain, 5))
        start = float(energy(at, speed))
        for _ in range(n):
            speed += 0.08 / n * acceleration(at, speed)
            at += 0.08 / n * speed
        drifts.append(abs(float(energy(at, speed)) - start))
    assert drifts[2] > 0
    for coarse, fine in pairwise(drifts):
        assert 1.8 < coarse / fine < 2.2


def test_momentum_is_kept_in_free_flight_and_falls_with_gravity() -> None:
    """dP/dt = (0, -g total mass), whatever the joints do."""
    for gravity in (0.0, 9.81):
        chain = Chain(half_cheetah().links, gravity)
        at, speed, torque = state(chain, 6)
        torque[:3] = 0

        def rate(q: ca.SX, v: ca.SX, chain: Chain = chain, torque: np.ndarray = torque) -> ca.SX:
            acceleration = ca.solve(chain.mass(q), ca.DM(torque) - chain.bias(q, v))
            momentum = chain.momentum(q, v)
            return ca.jtimes(momentum, q, v) + ca.jtimes(momentum, v, acceleration)

        expected = [0.0, -float(chain.total_mass) * gravity]
        np.testing.assert_allclose(evaluator(chain, rate)(at, speed).ravel(), expected, atol=1e-11)
        momentum = evaluator(chain, chain.momentum)(at, speed)
        by_mass = evaluator(chain, lambda q, v, c=chain: (c.mass(q) @ v)[:2])(at, speed)
        np.testing.assert_allclose(momentum, by_mass, atol=1e-12)


def test_springs_and_dampers_act_on_their_own_coordinates() -> None:
    chain = CHAINS["crane"]
    ones = np.ones(chain.nq)
    spring = evaluator(chain, lambda q, v: chain.spring(q))(ones, ones).ravel()
    damping = evaluator(chain, lambda q, v: chain.damping(v))(ones, ones).ravel()
    np.testing.assert_array_equal(spring, [0, 0, -20, 0, 0, 0, 0])
    np.testing.assert_array_equal(damping, [-0.3, 0, 0, 0, -0.2, -0.2, -0.2])


def test_numbers_may_be_symbols() -> None:
    """A pendulum's period needs mass, length and gravity as parameters of the graph."""
    m, length, g = ca.SX.sym("m"), ca.SX.sym("l"), ca.SX.sym("g")
    chain = Chain([Link("bob", None, m, 0.1, com=(0.0, -length))], gravity=g)
    q = ca.SX.sym("q")
    built = ca.Function("f", [q, m, length, g], [chain.mass(q), chain.bias(q, ca.SX(0))])
    mass, bias = (float(out) for out in built(0.3, 2.0, 0.5, 9.0))
    assert mass == pytest.approx(0.1 + 2.0 * 0.25)
    assert bias == pytest.approx(2.0 * 9.0 * 0.5 * np.sin(0.3))


@pytest.mark.parametrize("machine", [hopper(), half_cheetah()], ids=["hopper", "half-cheetah"])
def test_contact_jacobians_against_differences(machine) -> None:
    """J_n dq and J_t dq are the motion of the sphere's material point along normal and tangent."""
    chain = machine.tree()
    q = ca.SX.sym("q", chain.nq)
    at, dq, _ = state(chain, 7)
    contacts = machine.contacts(q)
    for sphere in machine.spheres:
        contact = contacts[sphere.name]
        pose = chain.pose(q, sphere.link)
        J = ca.Function("J", [q], list(contact.jacobians(q)))
        phi = ca.Function("phi", [q], [contact.phi])
        point = np.array(ca.Function("p", [q], [pose.to_local(contact.point)])(at)).ravel()
        carried = ca.Function("p", [q], [chain.position(q, sphere.link, tuple(point))])
        eps = 1e-6
        moved = np.array(carried(at + eps * dq) - carried(at - eps * dq)).ravel() / (2 * eps)
        normal, tangential = (float(row @ dq) for row in J(at))
        assert [tangential, normal] == pytest.approx(moved, abs=1e-8)
        slope = float(phi(at + eps * dq) - phi(at - eps * dq)) / (2 * eps)
        assert normal == pytest.approx(slope, abs=1e-8)


def test_half_cheetah_stands_on_both_feet_at_its_default_pose() -> None:
    """Both tips are at the contact radius, which depends on every anchor and offset of the table.

    They agree to four decimals, the digits of the published pose.
    """
    machine = half_cheetah()
    chain = machine.tree()
    q = ca.SX.sym("q", 9)
    for foot, tip in (("bfoot", (0.0, -0.188)), ("ffoot", (0.0, -0.140))):
        height = ca.Function("z", [q], [chain.position(q, foot, tip)[1]])
        assert float(height(machine.pose)) == pytest.approx(0.04600, abs=5e-5)
    phi = ca.Function("phi", [q], [c.phi for c in machine.contacts(q).values()])
    above = dict(zip((s.name for s in machine.spheres), phi(machine.pose), strict=True))
    touching = {name for name, value in above.items() if abs(float(value)) < 5e-5}
    assert touching == {"bfoot", "ffoot"}
    assert all(float(value) > -5e-5 for value in above.values())
    assert float(chain.total_mass) == pytest.approx(14.000, abs=5e-4)
    np.testing.assert_array_equal(np.diag(np.array(ca.DM(chain.B))[3:]), [120, 90, 60, 120, 60, 30])
    assert chain.limits[2] == (5, -0.4, 0.785)


def test_hopper_stands_upright_above_the_ground_at_q_zero() -> None:
    machine = hopper(base_damping=50.0, limits=True)
    chain = machine.tree()
    q = ca.SX.sym("q", 6)
    phi = ca.Function("phi", [q], [c.phi for c in machine.contacts(q).values()])
    above = [float(value) for value in phi(machine.pose)]
    assert above == pytest.approx([1.40, 1.00, 0.56, 0.04, 0.04], abs=1e-12)
    assert float(chain.total_mass) == pytest.approx(15.265, abs=5e-4)
    damping = ca.DM(chain.damping(ca.SX.ones(6)))
    assert np.array(damping).ravel().tolist() == [-50, -50, -50, -1, -1, -1]
    assert chain.limits[0] == (3, 0.0, pytest.approx(np.deg2rad(150)))
    assert hopper().tree().limits == []


@pytest.mark.parametrize(
    ("links", "sentence"),
    [
        ([Link("a", "b", 1, 1), Link("b", "a", 1, 1)], "cycle, a -> b -> a"),
        ([Link("a", "a", 1, 1)], "cycle, a -> a"),
        ([Link("a", None, 1, 1), Link("b", "c", 1, 1)], "'b' has the parent 'c', which is not a link"),
        ([Link("a", None, 1, 1), Link("a", None, 1, 1)], "two links are named 'a'"),
    ],
)
def test_a_chain_that_cannot_be_is_refused_in_one_sentence(links, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence) as refusal:
        Chain(links)
    assert "\n" not in str(refusal.value)
