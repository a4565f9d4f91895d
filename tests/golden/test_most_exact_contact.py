"""The most exact contact of a model, with true gaps and Coulomb friction, agrees with all modes tried out."""

from __future__ import annotations

import functools
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import fsolve

import problems
from dynamics.contact import Exact
from dynamics.systems import (
    ContactSystem,
    ParameterTable,
    quasi_dynamic,
    signals,
    time_stepping,
)
from problems.bodies.half_cheetah.machine import half_cheetah

H, FRICTION, R, REACH = 0.1, 0.5, 0.4, 0.5
MASS = np.diag([1.0, 1.0, 0.1, 50.0 * H**2, 50.0 * H**2])


def step(system: ContactSystem, x, u, values=None, law=None):
    """Return ``x_next``, ``lam`` and ``gap`` of one solved step."""
    closed = (law or Exact()).close(system)
    p = closed.p.values if values is None else values
    x_next, lam, gap, error = (np.array(v).ravel() for v in closed.solve(x, u, p))
    assert error.max() < 1e-9
    return x_next, lam, gap


def forces(system: ContactSystem, x, u, x_next, lam) -> list[np.ndarray]:
    f = system.forces
    assert f is not None
    symbols = [system.x, system.u, system.x_next, system.lam]
    function = ca.Function("forces", symbols, [f.normal, f.tangential, f.slip])
    return [np.array(v).ravel() for v in function(x, u, x_next, lam)]


@functools.cache
def pushed_disc(linearised: bool = True) -> ContactSystem:
    """Return the system of a disc (x, y, angle) and a smaller pusher (x, y), with friction between them."""

    def sliding(q: ca.SX) -> ca.SX:
        n = (q[:2] - q[3:]) / ca.norm_2(q[:2] - q[3:])
        return ca.horzcat(n[1], -n[0], R, -n[1], n[0])

    return quasi_dynamic(
        "pushed disc",
        states=signals("x [m]; y [m]; a [rad]; ax [m]; ay [m]"),
        inputs=signals("ux [m]; uy [m]"),
        contacts=signals("push [N s]"),
        h=H,
        mass=ca.SX(ca.DM(MASS[:3, :3])),
        stiffness=50.0 * ca.SX.eye(2),
        parameters=ParameterTable(),
        friction=FRICTION,
        distance=lambda q: ca.norm_2(q[:2] - q[3:]) - REACH,
        sliding=sliding,
        linearised=linearised,
    )


def modes_of_pushed_disc(x: np.ndarray, u: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Return the consistent modes of the contact, open, stick or sliding in one direction, with their next q.

    They follow from ``(M/h) dq = J_n' gamma + J_t' beta`` for the disc, and the same with ``h K``
    for the pusher, whose free position is the commanded one.
    """
    inertia = MASS / H
    free = np.concatenate([x[:3], u])
    apart = x[:2] - x[3:]
    n = apart / np.linalg.norm(apart)
    J_n = np.concatenate([n, [0.0], -n])
    J_t = np.array([n[1], -n[0], R, -n[1], n[0]])

    def end(impulse: np.ndarray) -> np.ndarray:
        return free + np.linalg.solve(inertia, J_n * impulse[0] + J_t * impulse[1])

    def phi(q: np.ndarray) -> float:
        return float(np.linalg.norm(q[:2] - q[3:]) - REACH)

    def stick(impulse: np.ndarray) -> list[float]:
        return [phi(end(impulse)), float(J_t @ (end(impulse) - x))]

    def slide(sign: float):
        return lambda impulse: [phi(end(impulse)), impulse[1] + sign * FRICTION * impulse[0]]

    found = []
    if phi(free) >= 0:
        found.append(("open", free))
    for mode, equations in (("stick", stick), ("ahead", slide(1.0)), ("back", slide(-1.0))):
        impulse = fsolve(equations, [0.1, 0.0], full_output=True)[0]
        gamma, beta = impulse
        slid = J_t @ (end(impulse) - x)
        fits = {"stick": abs(beta) <= FRICTION * gamma, "ahead": slid >= 0, "back": slid <= 0}[mode]
        if gamma >= 0 and fits and np.abs(equations(impulse)).max() < 1e-10:
            found.append((mode, end(impulse)))
    return found


@pytest.mark.costly
@pytest.mark.parametrize("linearised", [True, False])
def test_a_planar_push_ends_in_the_mode_that_fits(linearised: bool) -> None:
    sharp, seen = pushed_disc(linearised).most_exact, set()
    rng = np.random.default_rng(0)
    for _ in range(60):
        turn = rng.uniform(-np.pi, np.pi)
        away = (REACH + rng.uniform(0, 0.1)) * np.array([np.cos(turn), np.sin(turn)])
        x = np.concatenate([away, rng.normal(size=1), np.zeros(2)])
        u = rng.uniform(-0.25, 0.25, size=2)
        x_next, lam, _ = step(sharp, x, u)
        possible = modes_of_pushed_disc(x, u)
        nearest = min(possible, key=lambda mode: np.abs(mode[1] - x_next).max())
        np.testing.assert_allclose(x_next, nearest[1], atol=1e-6)
        seen.add(nearest[0])
        normal, tangential, slip = forces(sharp, x, u, x_next, lam)
        assert abs(tangential[0]) <= FRICTION * normal[0] + 1e-7
        # By maximum dissipation friction takes as much energy as the cone allows.
        lost, most = -tangential[0] * slip[0], FRICTION * normal[0] * abs(slip[0])
        assert lost == pytest.approx(most, abs=1e-6)
    assert seen == {"open", "stick", "ahead", "back"}


@functools.cache
def rubbing() -> ContactSystem:
    """Return the system of a finger (x, z) that is commanded into a fixed table, all of it actuated."""
    return quasi_dynamic(
        "finger",
        states=signals("x [m]; z [m]"),
        inputs=signals("ux [m]; uz [m]"),
        contacts=signals("table [N s]"),
        h=H,
        mass=ca.SX(0, 0),
        stiffness=10.0 * ca.SX.eye(2),
        parameters=ParameterTable(),
        distance=lambda q: q[1],
        friction=FRICTION,
        sliding=lambda q: ca.SX([[1.0, 0.0]]),
    )


@pytest.mark.parametrize("way", [-0.3, -0.06, 0.04, 0.3])
def test_a_sliding_contact_stays_closed_where_the_convex_one_lifts_off(way: float) -> None:
    """Commanded 0.1 m into the table, it slides by the part beyond the friction cone, |motion| - f 0.1."""
    x, u = np.zeros(2), np.array([way, -0.1])
    slid = np.sign(way) * max(0.0, abs(way) - FRICTION * 0.1)
    x_next, lam, _ = step(rubbing().most_exact, x, u)
    np.testing.assert_allclose(x_next, [slid, 0.0], atol=1e-9)
    np.testing.assert_allclose(lam[0], H * 10.0 * 0.1, rtol=1e-8)
    convex = step(rubbing(), x, u)[0]
    np.testing.assert_allclose(convex[1], FRICTION * abs(convex[0]), atol=1e-8)
    assert (convex[1] > 1e-3) == (abs(way) > 0.05)


def test_a_turning_body_keeps_its_true_distance() -> None:
    """A point inside a ring leaves it by the sagitta under the linearised gap, and not under the true one."""
    ring = thrown_in_a_ring()
    x = np.array([1.0, 0.0, 0.0, 2.0])
    out = [1.0 - np.hypot(*step(system, x, np.zeros(2))[0][:2]) for system in (ring, ring.most_exact)]
    assert out[0] == pytest.approx(1 - np.hypot(1.0, 0.2), rel=1e-9)
    assert out[1] == pytest.approx(0.0, abs=1e-9)


def thrown_in_a_ring() -> ContactSystem:
    return time_stepping(
        "ring",
        states=signals("x [m]; y [m]; vx [m/s]; vy [m/s]"),
        inputs=signals("fx [N]; fy [N]"),
        contacts=signals("ring [N s]"),
        h=H,
        mass=ca.SX.eye(2),
        impulse=lambda q, v, u: H * u,
        distance=lambda q: 1.0 - ca.norm_2(q),
        parameters=ParameterTable(),
        linearised=True,
    )


@pytest.mark.costly
def test_machines_with_expanded_gaps_are_refereed_by_true_ones() -> None:
    arguments = {"h": 0.02, "friction": 0.4, "spheres": ("bfoot", "ffoot")}
    expanded, true = (
        half_cheetah().system("cheetah", ParameterTable(), linearised=linearised, **arguments)
        for linearised in (True, False)
    )
    assert true.most_exact is true
    x = np.zeros(expanded.nx)
    x[1], x[9:12] = 0.45, [1.0, -3.0, 2.0]
    ends = [step(system, x, np.zeros(6))[0] for system in (expanded, expanded.most_exact, true)]
    np.testing.assert_array_equal(ends[1], ends[2])
    assert np.abs(ends[0] - ends[1]).max() > 1e-3


def by_hand(gap, distance) -> ContactSystem:
    """Return the system of a mass in the plane with explicit residual; ``gap`` is a function of (x, x_next, lam)."""
    x, x_next, lam = ca.SX.sym("x", 4), ca.SX.sym("x_next", 4), ca.SX.sym("lam")
    phi = distance(x)
    push = ca.gradient(phi, x)[:2] * lam
    return ContactSystem(
        name="by hand",
        x=x,
        u=ca.SX.sym("u", 0),
        x_next=x_next,
        lam=lam,
        residual=ca.vertcat(x_next[:2] - x[:2] - H * x_next[2:], x_next[2:] - x[2:] - push),
        gap=gap(x, x_next, lam),
        states=signals("x [m]; y [m]; vx [m/s]; vy [m/s]"),
        inputs=(),
        contacts=signals("ring [N s]"),
        h=H,
        phi=phi,
    )


def test_a_system_by_hand_is_sharpened_only_where_its_gap_is_an_expansion() -> None:
    def ring(x: ca.SX) -> ca.SX:
        return 1.0 - ca.norm_2(x[:2])

    def expanded(x: ca.SX, x_next: ca.SX, lam: ca.SX) -> ca.SX:
        return ring(x) + ca.jacobian(ring(x), x) @ (x_next - x)

    hand = by_hand(expanded, ring)
    x = np.array([1.0, 0.0, 0.0, 2.0])
    assert hand.referee_note == "true gaps"
    np.testing.assert_allclose(
        step(hand.most_exact, x, [])[0], step(thrown_in_a_ring().most_exact, x, [0, 0])[0], atol=1e-12
    )
    true = by_hand(lambda x, x_next, lam: ring(x_next), ring)
    bouncing = by_hand(lambda x, x_next, lam: ring(x_next) + 0.5 * ring(x), ring)
    springy = by_hand(lambda x, x_next, lam: ring(x_next) + lam / 100, ring)
    flat = by_hand(lambda x, x_next, lam: x_next[1], lambda x: x[1])
    for system in (true, bouncing, springy, flat):
        assert system.most_exact is system
        assert system.referee_note == "the model itself"
    unknown = replace(true, phi=None)
    assert unknown.most_exact is unknown
    assert unknown.referee_note is None


def test_an_affine_frictionless_model_is_its_own_referee() -> None:
    """With the gap at q+ instead of its expansion the step is the same."""
    for name in ("wall-1d", "push-1d", "ball-bounce", "hopper-1d"):
        system = problems.get(name).system
        assert system.most_exact is system
        assert system.phi is not None
        phi = ca.substitute(system.phi, system.x, system.x_next)
        gap = ca.vertcat(phi, system.gap[phi.numel() :, :])
        rng = np.random.default_rng(1)
        for _ in range(5):
            x, u = rng.normal(size=system.nx), rng.normal(size=system.nu)
            one, other = (step(s, x, u)[0] for s in (system, replace(system, gap=gap)))
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)


@pytest.mark.costly
def test_every_named_problem_says_who_referees_it() -> None:
    itself = "the model itself"
    coulomb = "true gaps, Coulomb friction with maximum dissipation"
    notes = {"push-disc": "true gaps", "planar-push": coulomb, "planar-hand": coulomb}
    for name in problems.names():
        system = problems.get(name).system
        assert system.referee_note == notes.get(name, itself)
        assert (system.most_exact is system) == (system.referee_note == itself)
        assert [str(s) for s in (system.x, system.u)] == [str(s) for s in (system.most_exact.x, system.most_exact.u)]
