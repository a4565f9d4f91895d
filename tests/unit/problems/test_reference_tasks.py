"""Mechanics of soft walls, of two fingers at discs, and of IDTO's hopper agree with closed forms."""

from __future__ import annotations

import math
from itertools import product

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

import problems
from dynamics.contact import Exact
from ocp.errors import InputError
from ocp.problem.problem import Problem
from problems.library.soft_walls import cost_to_go
from tests.unit.problems.test_problems import expressions

RNG = np.random.default_rng(0)
LENGTH, INERTIA, G = 1.0, 0.0839, 9.81


def at(problem: Problem, expression: ca.SX, x, u=None, x_next=None) -> np.ndarray:
    """Return the value of an expression in x, u and x_next at the default parameters."""
    s = problem.system
    u, after = np.zeros(s.nu) if u is None else u, x if x_next is None else x_next
    given = [s.x, s.u, s.x_next, s.parameters.vector]
    found = ca.Function("f", given, [ca.densify(expression)])
    return np.array(found(x, u, after, s.parameters.values)).squeeze()


def step(problem: Problem, x, u) -> tuple[np.ndarray, np.ndarray]:
    found = Exact().close(problem.system).solve(x, u, problem.parameters.values)
    assert np.max(found[3]) < 1e-7
    return np.array(found[0]).ravel(), np.array(found[1]).ravel()


def start(problem: Problem) -> np.ndarray:
    return problem.initial_states(problem.parameters.values)[0].copy()


@pytest.mark.parametrize("name", ["soft-walls", "spinner", "finger-disc", "idto-hopper"])
def test_every_parameter_reaches_the_problem_and_is_described(name: str) -> None:
    problem = problems.get(name)
    everything = expressions(problem)
    for row in problems.describe(problems.spec(name)):
        assert row["description"] and row["unit"]
        if row["name"] != "N":
            assert ca.depends_on(everything, problem.parameters[row["name"]]), row["name"]
    assert problems.get(name, N=5).N == 5


# Soft walls.


@pytest.mark.parametrize("given", [{}, {"mp": 0.1, "lc": 0.8, "w_u": 30.0, "h": 0.04}])
def test_the_cost_to_go_solves_the_riccati_equation(given: dict[str, float]) -> None:
    p = problems.spec("soft-walls").params(given)
    A, B = np.eye(4), p.h * np.array([[0], [0], [1 / p.mc], [1 / (p.lc * p.mc)]])
    A[0, 2] = A[1, 3] = p.h
    A[2, 1], A[3, 1] = p.h * G * p.mp / p.mc, p.h * G * (p.mc + p.mp) / (p.lc * p.mc)
    Q = np.diag([p.w_p, p.w_theta, p.w_dp, p.w_dtheta])
    problem = problems.get("soft-walls", **given)
    x = RNG.normal(size=(5, 4))
    P = np.array(ca.DM(cost_to_go(ca.SX(A), ca.SX(B), ca.SX(Q), ca.SX(p.w_u))))
    gain = np.linalg.solve(p.w_u + B.T @ P @ B, B.T @ P @ A)
    np.testing.assert_allclose(Q + A.T @ P @ (A - B @ gain), P, rtol=1e-9, atol=1e-9 * P.max())
    np.testing.assert_allclose(P, solve_discrete_are(A, B, Q, [[p.w_u]]), rtol=1e-8)
    for one in x:
        assert float(at(problem, problem.terminal_cost, one)) == pytest.approx(one @ P @ one)


def test_a_step_between_soft_walls_is_the_lcp_enumerated() -> None:
    """With the source's matrices exactly one of the four active sets is consistent."""
    mp, mc, lp, lc, d, ks, h = 0.411, 0.978, 0.6, 0.4267, 0.35, 100.0, 0.01
    A, D, E = np.zeros((4, 4)), np.zeros((4, 2)), np.array([[-1, lp, 0, 0], [1, -lp, 0, 0]])
    A[0, 2] = A[1, 3] = 1
    A[2, 1], A[3, 1] = G * mp / mc, G * (mc + mp) / (lc * mc)
    B = np.array([0, 0, 1 / mc, 1 / (lc * mc)])
    D[2] = -1 / mc + lp / (mc * lc), 1 / mc - lp / (mc * lc)
    turn = -1 / (mc * lc) + lp * (mc + mp) / (mc * mp * lc**2)
    D[3] = turn, -turn
    problem, seen = problems.get("soft-walls"), set()
    for _ in range(20):
        x, u = RNG.normal(size=4), 5 * RNG.normal()
        fits = []
        for acts in product((False, True), repeat=2):
            lam = np.where(acts, -ks * (E @ x + d), 0.0)
            gap = E @ x + lam / ks + d
            if lam.min() >= 0 and gap.min() >= -1e-12:
                fits.append((acts, lam))
        ((acts, lam),) = fits
        seen.add(acts)
        after, found = step(problem, x, [u])
        np.testing.assert_allclose(found, lam, atol=1e-8)
        np.testing.assert_allclose(after, x + h * (A @ x + B * u + D @ lam), atol=1e-9)
    assert seen == {(False, False), (True, False), (False, True)}


# Fingers.


def tip_of(name: str, q: np.ndarray) -> np.ndarray:
    """Return the tip's centre, 0.95 m or 1 m along the second link."""
    far = 0.95 if name == "spinner" else 1.0
    upper, fore = q[0], q[0] + q[1]
    return np.array([math.sin(upper) + far * math.sin(fore), math.cos(upper) + far * math.cos(fore)])


def finger_state(name: str) -> np.ndarray:
    return RNG.normal(size=problems.get(name).system.nx)


@pytest.mark.parametrize(("name", "m", "disc"), [("spinner", 1.0, 0.074), ("finger-disc", 0.5, 0.0225)])
def test_the_fingers_mass_matrix_in_closed_form(name: str, m: float, disc: float) -> None:
    problem, x = problems.get(name), finger_state(name)
    assert problem.system.mass is not None
    cos, centre = math.cos(x[1]), LENGTH / 2
    last = INERTIA + m * centre**2
    cross = last + m * LENGTH * centre * cos
    first = INERTIA + m * centre**2 + last + m * LENGTH**2 + 2 * m * LENGTH * centre * cos
    expected = [[first, cross, 0], [cross, last, 0], [0, 0, disc]]
    np.testing.assert_allclose(at(problem, problem.system.mass, x), expected, rtol=1e-12)


@pytest.mark.parametrize(("name", "R", "tip"), [("spinner", 0.25, 0.05), ("finger-disc", 0.3, 0.0)])
def test_gap_and_slip_are_those_of_two_discs(name: str, R: float, tip: float) -> None:
    """The slip is the tangential velocity of the tip's material point less that of the disc's."""
    problem, x, eps = problems.get(name), finger_state(name), 1e-6
    system = problem.system
    assert system.phi is not None and system.forces is not None
    q, v = x[:3], x[3:6]
    off = tip_of(name, q) - [1.5, 1.0]
    away = float(np.linalg.norm(off))
    assert float(at(problem, system.phi, x)) == pytest.approx(away - R - tip, abs=1e-12)
    ahead, behind = (tip_of(name, q + s * eps * v) for s in (1, -1))
    normal = off / away
    tangent = np.array([normal[1], -normal[0]])
    # Rotation is clockwise, as angles are: a point at r from the centre moves by omega (r_z, -r_x).
    own = (v[0] + v[1]) * np.array([-tip * normal[1], tip * normal[0]])
    rim = v[2] * (R + (away - R - tip)) * tangent
    slip = tangent @ ((ahead - behind) / (2 * eps) + own - rim)
    after = np.concatenate([q, v, x[6:]])
    found = at(problem, system.forces.slip, x, x_next=after)
    assert float(found) == pytest.approx(slip, abs=1e-8)


@pytest.mark.parametrize(("name", "m"), [("spinner", 1.0), ("finger-disc", 0.5)])
def test_torques_against_gravity_hold_the_finger(name: str, m: float) -> None:
    problem = problems.get(name)
    x = start(problem)
    upper, fore = x[0], x[0] + x[1]
    last = -m * G * LENGTH / 2 * math.sin(fore)
    hold = np.array([-1.5 * m * G * LENGTH * math.sin(upper) + last, last])
    after, lam = step(problem, x, hold)
    np.testing.assert_allclose(after[:6], x[:6], atol=1e-7)
    assert lam[0] == pytest.approx(0, abs=1e-6), "nothing presses"


def test_the_finger_starts_where_it_touches_with_its_elbow_up() -> None:
    problem = problems.get("finger-disc")
    x = start(problem)
    np.testing.assert_allclose(tip_of("finger-disc", x), [1.2, 1.0], atol=1e-12)
    elbow = np.array([math.sin(x[0]), math.cos(x[0])])
    assert elbow[1] > 1.0 / 1.2 * elbow[0], "above the line to the tip"
    assert x[1] > 0 and not x[2:].any()
    with pytest.raises(InputError, match=r"2\.3 m away, and reaches up to 2 m"):
        problems.get("finger-disc", x=2.6, z=0.0)


@pytest.mark.parametrize(
    ("values", "starts_free"),
    [
        ({}, True),
        ({"away": 0.12}, False),
        ({"body": "cube"}, True),
        ({"body": "cube", "r": 0.04}, False),
        ({"body": "cube", "z0": 0.24, "away": 0.05}, True),
        ({"body": "cube", "z0": 0.22, "away": 0.11}, False),
    ],
)
def test_fingertips_that_reorient_start_outside_the_object(values: dict[str, float | str], starts_free: bool) -> None:
    """Two of the tips start near a corner of the cube; a tip above it is free if z0 >= 2 a + r."""
    params = problems.spec("reorient").params
    if starts_free:
        params(values)
        return
    with pytest.raises(InputError, match="a fingertip starts inside"):
        params(values)


@pytest.mark.costly_cases("idto-hopper--0.25")
@pytest.mark.parametrize(("name", "rate"), [("spinner", 1.0), ("idto-hopper", -0.25)])
def test_a_nominal_runs_at_its_rate_at_any_step_size(name: str, rate: float) -> None:
    for h in (0.05, 0.01):
        problem = problems.get(name, h=h)
        x = start(problem)
        x[-1] = 0.7
        assert step(problem, x, np.zeros(2))[0][-1] == pytest.approx(0.7 + h * rate, abs=1e-12)
    cost = problem.cost_terms
    p, lam = problem.parameters, np.zeros(problem.system.nlam)
    x[2 if name == "spinner" else 0] = 0.7 + 0.2
    one = [float(v) for v in cost(x, np.zeros(2), np.zeros(2), lam, p.pack({"lead": 0.2}))]
    np.testing.assert_allclose(one, 0, atol=1e-12)


# IDTO's hopper.


def test_idtos_hopper_stands_on_both_discs_and_falls_freely() -> None:
    problem = problems.get("idto-hopper")
    x = start(problem)
    assert problem.system.phi is not None
    height = 0.2 * math.cos(0.3) + 0.4 * math.cos(-0.2) + 0.03
    np.testing.assert_allclose(at(problem, problem.system.phi, x), 0.6131 - height)
    x[1] += 1.0
    after, _ = step(problem, x, np.zeros(2))
    expected = x.copy()
    expected[6], expected[1] = -G * 0.05, x[1] - G * 0.05**2
    expected[10] = -0.0125
    np.testing.assert_allclose(after, expected, atol=1e-9)
    with pytest.raises(InputError, match=r"starts 0\.00309 m inside the ground"):
        problems.get("idto-hopper", z0=0.61)


def test_stiffness_and_damping_are_the_implicit_pd_of_the_joints() -> None:
    """In the air the step solves ``M (v+ - v) = h (B u - b - D v+ - K q+)``."""
    K, D, h, wanted = 100.0, 5.0, 0.05, np.array([-0.2, 0.5])
    free, held = (problems.get("idto-hopper", **more) for more in ({}, {"stiffness": K, "damping": D}))
    x = start(free)
    x[1] += 1.0
    x[5:10] = RNG.normal(size=5)
    u = K * wanted
    assert free.system.mass is not None
    M, B = at(free, free.system.mass, x), np.eye(5)[:, 3:]
    forced = M @ step(free, x, u)[0][5:10]
    own = h * B @ (K * x[3:5])
    expected = np.linalg.solve(M + B @ B.T * (h * D + h**2 * K), forced - own)
    np.testing.assert_allclose(step(held, x, u)[0][5:10], expected, atol=1e-8)
