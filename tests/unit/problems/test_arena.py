"""Arena tasks state the mechanics of their sources: steps, pairs and costs agree with formulas typed from them."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

import problems
from ocp.errors import InputError
from ocp.problem.problem import Problem
from problems.arena.published import instance_parameters, published_results
from problems.registry import arena_names
from reports.documents.citations import full_citation
from reports.drawing.notation import plain

MIDPOINT = {"acrobot-stops": ("momentum", 2), "cartpole-friction": ("momentum", 2)}
WITH_INSTANCES = ("acrobot-stops", "cartpole-friction", "pushing-obstacle")


def evaluated(problem: Problem, expression: ca.SX, x=0, u=0, lam=0) -> np.ndarray:
    """Return an expression in x, u, lam at the problem's parameters, with x_next zero."""
    s = problem.system
    symbols = [s.x, s.u, s.lam, s.x_next, s.parameters.vector]
    value = ca.Function("value", symbols, [ca.densify(expression)])
    return np.array(value(x, u, lam, 0, s.parameters.values)).ravel()


def next_state(problem: Problem, x, u, lam) -> np.ndarray:
    """Return the next state of a step whose residual is x_next minus a function of (x, u, lam)."""
    return -evaluated(problem, problem.system.residual, x, u, lam)


def row(problem: Problem, name: str, x, u, lam) -> np.ndarray:
    """Return the value of a path constraint."""
    expression = next(row.expression for row in problem.path if row.name == name)
    return evaluated(problem, expression, x, u, lam)


def normal_map(y: float, limit: float) -> tuple[float, float, float]:
    """Return the force within its limit, and the parts of y above and below."""
    force = float(np.clip(y, -limit, limit))
    return force, max(y - limit, 0.0), max(-limit - y, 0.0)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(3)


@pytest.mark.parametrize("name", arena_names())
def test_every_task_is_described_and_sourced(name: str) -> None:
    assert name not in problems.names()
    spec = problems.spec(name)
    assert spec.equations and spec.citation is not None and full_citation(spec.citation.key)
    for described in problems.describe(spec):
        assert described["description"] and described["unit"]
    for line in spec.equations:
        shown = plain(line)
        assert "dot" not in shown and shown.count("(") == shown.count(")")
    problem = problems.get(name)
    values = {**dict(zip(problem.parameters.names, problem.parameters.values, strict=True)), **problem.origin.settings}
    assert values == spec.params({}).model_dump()
    start = problem.initial_states(problem.parameters.values)[0]
    assert spec.draw is None or spec.draw(spec.params({}), start)


@pytest.mark.parametrize("name", WITH_INSTANCES)
def test_an_instance_sets_the_parameters_of_its_row_unless_they_are_given(name: str) -> None:
    drawn = instance_parameters(name, 7)
    problem = problems.get(name, instance=7)
    assert problem.origin.settings["instance"] == 7
    assert {key: problem.parameters.defaults[key] for key in drawn} == drawn != instance_parameters(name, 8)
    changed = next(iter(drawn))
    assert problems.get(name, instance=7, **{changed: 1.5}).parameters.defaults[changed] == 1.5
    with pytest.raises(InputError, match=r"instance .* <= 100, got 101"):
        problems.get(name, instance=101)


@pytest.mark.parametrize(
    ("name", "solver", "solved", "median"),
    [
        ("cartpole-friction", "ipddp2", 100, 0.92007),
        ("cartpole-friction", "ipopt", 100, 0.92575),
        ("cartpole-friction", "proxddp", 77, None),
        ("acrobot-stops", "ipddp2", 100, 1.0590),
        ("acrobot-stops", "ipopt", 100, 0.9595),
        ("acrobot-stops", "proxddp", 24, None),
        ("pushing-obstacle", "ipddp2", 98, 0.03294),
        ("pushing-obstacle", "ipopt", 89, 0.03874),
        ("pushing-obstacle", "proxddp", 77, None),
    ],
)
def test_stored_results_have_the_published_counts_and_medians(name, solver, solved, median) -> None:
    results = [result for result in published_results(name) if result.solver == solver]
    assert [result.instance for result in results] == list(range(1, 101))
    assert sum(result.solved for result in results) == solved
    if median is not None:
        costs = [result.cost for result in results]
        assert min(abs(np.median(costs) - median), abs(np.median(costs) / median - 1)) < 5e-4
    assert published_results("waiter") == []


def test_pushbot_accelerates_as_its_source_says_and_walls_push_by_their_stiffness(rng) -> None:
    problem, mc, mp, length, g, h = problems.get("pushbot"), 1.0, 0.1, 0.8, 9.8, 0.02
    for _ in range(20):
        x, u, (l1, l2) = rng.normal(size=4), rng.normal(), rng.uniform(0, 5, 2)
        p, th, dp, dth = x
        c, s, D = np.cos(th), np.sin(th), mc + mp - mp * np.cos(th) ** 2
        ddp = (l2 - l1 + u + (l1 - l2) * c**2 - g * mp * c * s + length * mp * dth**2 * s) / D
        moment = (l1 - l2) * mc * c + mp * u * c - g * mp**2 * s - g * mc * mp * s + length * mp**2 * dth**2 * c * s
        v = np.array([dp + h * ddp, dth - h * moment / (length * mp * D)])
        np.testing.assert_allclose(next_state(problem, x, u, [l1, l2]), [*(x[:2] + h * v), *v], rtol=1e-12)
        tip = p + length * s
        gap = evaluated(problem, problem.system.gap, x, u, [l1, l2])
        np.testing.assert_allclose(gap, [1 - tip + l1 / 200, 1 + tip + l2 / 200], rtol=1e-12)


def test_a_rollout_of_pushbot_satisfies_the_step_with_the_springs_closed_form(rng) -> None:
    problem, x = problems.get("pushbot"), np.array([0.8, 1.2, 2.0, 0.5])
    touched = 0
    for force in rng.normal(size=60):
        tip = x[0] + 0.8 * np.sin(x[1])
        lam = 200 * np.maximum([tip - 1, -1 - tip], 0)
        touched += bool(lam.any())
        found = np.array(problem.exact_step.solve(x, force, problem.parameters.values)[0]).ravel()
        x = next_state(problem, x, force, lam)
        np.testing.assert_allclose(found, x, rtol=1e-9, atol=1e-9)
    assert touched > 3


def test_transport_slides_where_its_input_exceeds_friction(rng) -> None:
    problem, h, b = problems.get("transport"), 0.02, 0.2 * 9.81
    for y in rng.normal(0, 4, 20):
        x, force = rng.normal(size=4), rng.normal()
        f, above, below = normal_map(y, b)
        lam = [below, above]
        v = x[2:] + h * np.array([f, (force - f) / 2])
        np.testing.assert_allclose(next_state(problem, x, [force, y], lam), [*(x[:2] + h * v), *v], rtol=1e-12)
        gap = evaluated(problem, problem.system.gap, x, [force, y], lam)
        np.testing.assert_allclose(gap, [f + b, b - f], atol=1e-12)
        np.testing.assert_allclose(row(problem, "slip", x, [force, y], lam), x[2] - x[3] - (below - above), rtol=1e-9)
        cost = problem.cost_terms(x, [force, y], 0, lam, problem.parameters.values)
        error = x - [-0.5, 0, -2, -2]
        expected = 1e-4 * (f**2 + force**2), np.dot([1e5, 1e5, 10, 10], error**2)
        np.testing.assert_allclose([float(value) for value in cost], expected, rtol=1e-12)


def test_waiter_holds_both_frictions_within_their_cones(rng) -> None:
    problem, h, weight = problems.get("waiter"), 0.05, 2 * 9.81
    for _ in range(20):
        x, force, n, y = rng.normal(size=4), rng.normal(), rng.uniform(1, 19), rng.normal(0, 10, 2)
        F, p, q = normal_map(y[0], 1.0 * n)
        G, v, w = normal_map(y[1], 0.1 * (weight - n))
        u, lam = [force, n, *y], [p, v, q, w]
        speed = x[2:] + h * np.array([(F - G) / 2, force - F])
        np.testing.assert_allclose(next_state(problem, x, u, lam), [*(x[:2] + h * speed), *speed], rtol=1e-12)
        gap, pressed = evaluated(problem, problem.system.gap, x, u, lam), 0.1 * (weight - n)
        np.testing.assert_allclose(gap, [n - F, pressed - G, n + F, pressed + G], atol=1e-9)
        assert np.dot(lam, gap) == pytest.approx(0, abs=1e-9)
        np.testing.assert_allclose(row(problem, "slip", x, u, lam), [x[3] - x[2] - (p - q), x[2] - (v - w)], rtol=1e-9)
        lever = weight * 7 - n * (x[1] - x[0] + 7)
        np.testing.assert_allclose(row(problem, "no tipping", x, u, lam), lever, rtol=1e-12)


@pytest.mark.parametrize("stance", [True, False])
def test_the_hoppers_pairs_give_the_products_of_its_source(stance: bool, rng) -> None:
    problem, h, g = problems.get("stance-hopper"), 0.02, 9.81
    for _ in range(10):
        px, py, qx, th, dpx, dpy, turn = rng.normal(size=7)
        r, qy = (0.3, 0.0) if stance else (0.0, 0.4)
        x, lam = np.array([px, py, qx, qy, th, r, dpx, dpy]), [0, 8] if stance else [8, 0]
        thrust = rng.uniform(0, 50)
        u = [0.2, 0, 0, 0, turn, 0, thrust] if stance else [0.2, 0, rng.normal(), 0.9, 0, turn, 0]
        gap = evaluated(problem, problem.system.gap, x, u, lam)
        assert np.all(gap >= 0) and np.dot(gap, lam) == 0
        assert np.all(row(problem, "phase", x, u, lam) >= 0)
        after, u1, u2 = next_state(problem, x, u, lam), u[5], u[6]
        products = r * (after[2] - qx), r * (after[3] - qy), qy * (after[4] - th - h * u1), u2 * qy, u1**2 * r, r * qy
        np.testing.assert_allclose(products, 0, atol=1e-14)
        v = np.array([dpx - h * u2 * np.sin(th), dpy + h * (u2 * np.cos(th) - g)])
        np.testing.assert_allclose(after[[0, 1, 6, 7]], [px + h * v[0], py + h * v[1], *v], rtol=1e-12)
        leg = [(1 - r) * np.cos(th) - py + qy, (1 - r) * np.sin(th) - qx + px]
        np.testing.assert_allclose(row(problem, "leg", x, u, lam), leg, rtol=1e-9, atol=1e-12)
        # What is bounded by a multiplier that is zero must be zero itself.
        for index in (2, 3, 5) if stance else (4, 6):
            moved = np.array(u)
            moved[index] += 0.01
            assert row(problem, "phase", x, moved, lam).min() < 0


def test_the_hoppers_guess_hops_in_place_as_its_source_does() -> None:
    problem = problems.get("stance-hopper")
    x, u = problem.initial_guess(problem.parameters.values)
    for k in range(problem.N):
        lam = [0, 8] if x[k, 5] > 0 else [8, 0]
        np.testing.assert_allclose(next_state(problem, x[k], u[k], lam), x[k + 1], atol=1e-12)
        np.testing.assert_allclose(row(problem, "leg", x[k], u[k], lam), 0, atol=1e-12)
        assert row(problem, "clearance", x[k], u[k], lam) >= -1e-12
    # Nodes of the source's file, rounded to six digits.
    for k, height, speed in ((14, 1.08798, -2.7468), (18, 0.864312, -2.3544), (40, 1.39013, 1.5696)):
        np.testing.assert_allclose(x[k, [1, 7]], [height, speed], rtol=1e-5)


def acrobot(p: dict[str, float]):
    """Return mass matrix and bias as the source states them."""
    m1, l1, m2, inertia, lc, g = p["m1"], p["l1"], p["m2"], 0.333, 0.5, 9.81

    def M(q):
        c = m2 * l1 * lc * math.cos(q[1])
        return np.array([[inertia + inertia + m2 * l1**2 + 2 * c, inertia + c], [inertia + c, inertia]])

    def C(q, v):
        s = m2 * l1 * lc * math.sin(q[1])
        gravity = m2 * g * lc * math.sin(q[0] + q[1])
        first = -2 * s * v[0] * v[1] - s * v[1] ** 2 + m1 * g * lc * math.sin(q[0]) + m2 * g * l1 * math.sin(q[0])
        return np.array([first + gravity, s * v[0] ** 2 + gravity])

    return M, C


def cartpole(p: dict[str, float]):
    """Return mass matrix and bias as the source states them."""
    mc, mp, length = p["mc"], p["mp"], p["l"]

    def M(q):
        return np.array([[mc + mp, mp * length * math.cos(q[1])], [mp * length * math.cos(q[1]), mp * length**2]])

    def C(q, v):
        return np.array([-mp * length * v[1] ** 2, mp * 9.81 * length]) * math.sin(q[1])

    return M, C


def balance(M, C, before, now, after) -> np.ndarray:
    """Return the change of momentum from three poses, D = 0.05 s apart."""
    D, mean = 0.05, lambda a, b: (a + b) / 2
    v0, v1 = (now - before) / D, (after - now) / D
    m0, m1 = mean(before, now), mean(now, after)
    return M(m1) @ v1 - M(m0) @ v0 + D / 2 * (C(m1, v1) + C(m0, v0))


def test_acrobot_balances_momentum_and_stops_at_right_angles(rng) -> None:
    problem, D = problems.get("acrobot-stops", instance=3), 0.05
    M, C = acrobot(instance_parameters("acrobot-stops", 3))
    for command in rng.normal(0, 2, 20):
        q, v, tau, w = rng.normal(size=2), rng.normal(size=2), rng.normal(), rng.normal()
        elbow, upper, lower = normal_map(command, math.pi / 2)
        u, lam = [tau, w, command], [upper, lower]
        after = np.array([q[0] + D * w, elbow])
        v_next = (after - q) / D
        expected = balance(M, C, q - D * v, q, after) + D * 0.5 * v_next - [0, D * tau + lower - upper]
        x = np.concatenate([q, v])
        np.testing.assert_allclose(row(problem, "momentum", x, u, lam), expected, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(next_state(problem, x, u, lam), [*after, *v_next], rtol=1e-9, atol=1e-12)
        gap = evaluated(problem, problem.system.gap, x, u, lam)
        np.testing.assert_allclose(gap, [math.pi / 2 - elbow, math.pi / 2 + elbow], atol=1e-12)


def test_cartpole_slides_against_its_largest_friction(rng) -> None:
    problem, D, p = problems.get("cartpole-friction", instance=3), 0.05, instance_parameters("cartpole-friction", 3)
    M, C = cartpole(p)
    gamma = p["f1"] * (p["mp"] + p["mc"]) * 9.81, p["f2"] * p["mp"] * 9.81 * p["l"]
    for y in rng.normal(0, 2, (20, 2)):
        q, v, F = rng.normal(size=2), rng.normal(size=2), rng.normal()
        (f1, a1, c1), (f2, a2, c2) = (normal_map(*pair) for pair in zip(y, gamma, strict=True))
        u, lam, v_next = [F, *y], [a1, a2, c1, c2], np.array([c1 - a1, c2 - a2])
        x, friction = np.concatenate([q, v]), np.array([f1, f2])
        expected = balance(M, C, q - D * v, q, q + D * v_next) - D * (np.array([F, 0]) + friction)
        np.testing.assert_allclose(row(problem, "momentum", x, u, lam), expected, rtol=1e-9, atol=1e-9)
        # The six pairs of the source, with its b+, b- and psi.
        up, down, psi = np.maximum(friction, 0), np.maximum(-friction, 0), np.abs(v_next)
        pairs = (v_next + psi) * up, (psi - v_next) * down, psi * (gamma - up - down)
        np.testing.assert_allclose(pairs, 0, atol=1e-12)
        gap = evaluated(problem, problem.system.gap, x, u, lam)
        np.testing.assert_allclose(gap, [*(gamma - friction), *(gamma + friction)], atol=1e-12)
