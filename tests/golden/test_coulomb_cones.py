"""Coulomb friction in time stepping: closed forms, and both forms of the cone."""

from __future__ import annotations

import functools

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynamics.contact import Barrier, Exact
from dynamics.systems import (
    ContactSystem,
    EnergyBalance,
    ParameterTable,
    quasi_dynamic,
    signals,
    time_stepping,
)
from dynamics.systems.contact_rows import Cone

H, G, FRICTION = 0.05, 9.81, 0.5
CONES: tuple[Cone, ...] = ("linearised", "second-order")


@functools.cache
def block(cone: Cone) -> ContactSystem:
    """Return the system of a unit mass on a floor, q = (x, z), pushed along it."""
    return time_stepping(
        "block",
        states=signals("x [m]; z [m]; vx [m/s]; vz [m/s]"),
        inputs=signals("f [N]"),
        contacts=signals("floor [N s]"),
        mass=ca.SX.eye(2),
        impulse=lambda q, v, u: H * ca.vertcat(u, -G),
        distance=lambda q: q[1],
        sliding=lambda q: ca.SX([[1.0, 0.0]]),
        friction=FRICTION,
        cone=cone,
        h=H,
        parameters=ParameterTable(),
    )


@functools.cache
def rod(cone: Cone) -> ContactSystem:
    """Return the system of a rod whose two ends may touch the floor, q = (x, z, angle)."""

    def ends(q: ca.SX) -> list[ca.SX]:
        arm = 0.4 * ca.vertcat(ca.sin(q[2]), -ca.cos(q[2]))
        return [q[:2] + arm, q[:2] - arm]

    return time_stepping(
        "rod",
        states=signals("x [m]; z [m]; a [rad]; vx [m/s]; vz [m/s]; va [rad/s]"),
        inputs=signals("f [N]"),
        contacts=signals("one [N s]; other [N s]"),
        mass=ca.diag(ca.SX([1.0, 1.0, 0.1])),
        impulse=lambda q, v, u: H * ca.vertcat(u, -G, 0),
        distance=lambda q: ca.vertcat(*(end[1] for end in ends(q))),
        sliding=lambda q: ca.vertcat(*(ca.jacobian(end[0], q) for end in ends(q))),
        friction=FRICTION,
        cone=cone,
        h=H,
        energy_balance=lambda q, v, u, v_next, n, t: EnergyBalance(
            0.5 * (v[0] ** 2 + v[1] ** 2 + 0.1 * v[2] ** 2) + G * q[1],
            H * u * v_next[0],
            v[:2],
            ca.vertcat(ca.sum1(t), ca.sum1(n) - H * G),
        ),
        parameters=ParameterTable(),
    )


def step(system: ContactSystem, law, x, u):
    closed = law.close(system)
    x_next, lam, gap, error = (np.array(v).ravel() for v in closed.solve(x, u, closed.p.values))
    assert error.max() < 1e-9
    return x_next, lam, gap


def forces(system: ContactSystem, x, u, x_next, lam) -> list[np.ndarray]:
    f = system.forces
    assert f is not None
    function = ca.Function("forces", [system.x, system.u, system.x_next, system.lam], [f.normal, f.tangential, f.slip])
    return [np.array(v).ravel() for v in function(x, u, x_next, lam)]


@pytest.mark.one_case_in(2)
@pytest.mark.parametrize("cone", CONES)
@pytest.mark.parametrize("push", [-9.0, -4.0, 0.0, 4.0, 9.0])
def test_a_block_sticks_below_the_bound_and_slides_above(cone, push):
    x = np.zeros(4)
    x_next, lam, _ = step(block(cone), Exact(), x, push)
    bound = FRICTION * G
    slides = np.sign(push) * H * max(0.0, abs(push) - bound)
    np.testing.assert_allclose(x_next[2:], [slides, 0.0], atol=1e-9)
    normal, tangential, slip = forces(block(cone), x, push, x_next, lam)
    np.testing.assert_allclose(normal, H * G, rtol=1e-8)
    held = -H * np.clip(push, -bound, bound)
    np.testing.assert_allclose(tangential, held, atol=1e-8)
    np.testing.assert_allclose(slip, slides, atol=1e-9)


@pytest.mark.parametrize("mu", [1e-3, 1e-5])
@pytest.mark.parametrize("push", [-6.0, 1.0, 4.9, 12.0])
def test_the_second_order_barrier_is_that_of_its_cone(mu, push):
    """v+ = h (u + f), f the root of ``h v+ = -2 mu b / (bound² - b²)``, b = h f, as in Zhang et al. 2023, fig. 6."""
    system, x = block("second-order"), np.zeros(4)
    x_next, lam, _ = step(system, Barrier(mu=mu), x, push)
    normal, b, slip = forces(system, x, push, x_next, lam)
    bound = FRICTION * normal
    np.testing.assert_allclose(H * slip, -mu * b / (bound**2 - b**2), rtol=1e-7)
    np.testing.assert_allclose(x_next[2], H * push + b, rtol=1e-9)


@pytest.mark.costly
@pytest.mark.parametrize("cone", CONES)
@settings(max_examples=25, deadline=None)
@given(
    angle=st.floats(-3.0, 3.0),
    height=st.floats(0.0, 0.3),
    velocity=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    push=st.floats(-20.0, 20.0),
)
def test_impacts_of_a_rod_are_coulombs(cone, angle, height, velocity, push):
    system = rod(cone)
    lowest = 0.4 * abs(np.cos(angle))
    x = np.array([0.0, lowest + height, angle, *velocity])
    x_next, lam, gap = step(system, Exact(), x, push)
    assert lam.min() >= 0
    assert gap.min() >= 0
    normal, tangential, slip = forces(system, x, push, x_next, lam)
    scale = 1e-7 * (1 + np.abs(lam).max())
    assert np.all(np.abs(tangential) <= FRICTION * normal + scale)
    # By maximum dissipation friction takes as much energy as its cone allows.
    np.testing.assert_allclose(
        -tangential * slip, FRICTION * normal * np.abs(slip), atol=1e-5 * (1 + np.abs(slip).max())
    )


@pytest.mark.costly
@settings(max_examples=25, deadline=None)
@given(
    angle=st.floats(-1.2, 1.2),
    velocity=st.tuples(st.floats(-2.0, 2.0), st.floats(-2.0, 0.0), st.floats(-2.0, 2.0)),
)
def test_both_cones_are_one_law_at_mu_zero(angle, velocity):
    x = np.array([0.0, 0.4 * np.cos(angle) + 0.01, angle, *velocity])
    one, other = (step(rod(cone), Exact(), x, 0.0)[0] for cone in CONES)
    np.testing.assert_allclose(one, other, atol=2e-5)


@pytest.mark.costly
@pytest.mark.parametrize("cone", CONES)
def test_a_falling_rod_keeps_its_books(cone):
    system = rod(cone)
    book = system.energy_balance
    assert book is not None
    evaluated = ca.Function(
        "book",
        [system.x, system.u, system.x_next, system.lam],
        [book.energy, book.work, book.momentum, book.external],
    )
    x, lost = np.array([0.0, 0.8, 0.9, 1.0, 0.0, -1.0]), 0.0
    for _ in range(60):
        x_next, lam, _ = step(system, Exact(), x, 0.0)
        energy, work, momentum, external = evaluated(x, 0.0, x_next, lam)
        after, _, momentum_after, _ = evaluated(x_next, 0.0, x_next, lam)
        np.testing.assert_allclose(np.array(momentum_after - momentum), np.array(external), atol=1e-9)
        change = float(after - energy - work)
        # Semi-implicit Euler adds at most the work of gravity over half a step.
        assert change <= 0.5 * (G * H) ** 2 + 1e-9
        lost -= change
        x = x_next
    assert lost > 3.0
    assert abs(x[3:]).max() < 1e-6


def test_a_dragged_disc_follows_coulomb_in_the_plane():
    """Quasi-dynamic rows are the edges of a cone, so that friction bounds a pusher's sideways drag."""
    system = quasi_dynamic(
        "drag",
        states=signals("x [m]; y [m]; ax [m]; ay [m]"),
        inputs=signals("ux [m]; uy [m]"),
        contacts=signals("c [N s]"),
        h=0.1,
        mass=ca.SX.eye(2),
        stiffness=100 * ca.SX.eye(2),
        distance=lambda q: q[0] - q[2] - 0.5,
        sliding=lambda q: ca.SX([[0.0, 1.0, 0.0, -1.0]]),
        friction=FRICTION,
        parameters=ParameterTable(),
    )
    x = np.array([0.5, 0.0, 0.0, 0.0])
    for sideways, sticks in ((0.02, True), (0.5, False)):
        u = np.array([0.1, sideways])
        x_next, lam, _ = step(system, Exact(), x, u)
        normal, tangential, slip = forces(system, x, u, x_next, lam)
        assert normal[0] > 0
        assert (abs(slip[0]) < 1e-7) == sticks
        at_bound = abs(abs(tangential[0]) - FRICTION * normal[0]) < 1e-8
        assert at_bound != sticks
        # By Newton's law the impulses give the object's motion.
        np.testing.assert_allclose((x_next - x)[:2] / 0.1, [normal[0], tangential[0]], rtol=1e-7)


@pytest.mark.parametrize("force", [2.0, 12.0, -12.0])
def test_edges_of_the_cone_are_the_convex_program_and_are_refereed_by_coulomb(force: float) -> None:
    """With the cone's edges the block's free velocity is projected onto the wedge ``vz >= f |vx|``."""
    system, free = block("edges"), H * np.array([force, -G])
    x_next, lam, _ = step(system, Exact(), np.zeros(4), np.array([force]))
    edge = np.array([np.sign(force), FRICTION]) / np.hypot(1, FRICTION)
    wanted = edge * max(0.0, edge @ free)
    np.testing.assert_allclose(x_next[2:], wanted, atol=1e-9)
    normals = np.array([[FRICTION, 1.0], [-FRICTION, 1.0]])
    np.testing.assert_allclose(normals.T @ lam, wanted - free, atol=1e-9)
    assert lam.min() >= -1e-12
    assert system.referee_note == "Coulomb friction with maximum dissipation"
    np.testing.assert_allclose(
        step(system.most_exact, Exact(), np.zeros(4), np.array([force]))[0],
        step(block("linearised"), Exact(), np.zeros(4), np.array([force]))[0],
        atol=1e-9,
    )
