"""Arena tasks with a pusher, discs, a tether or walls: steps agree with formulas typed from their sources."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest

import problems
from ocp import solve
from ocp.problem.problem import Problem
from problems.arena.drone_tether import reference
from problems.arena.published import instance_parameters, published_results
from tests.unit.problems.test_arena import next_state, row


def exact_step(problem: Problem, x, u) -> tuple[np.ndarray, np.ndarray]:
    """Return next state and multipliers of a step under the exact law."""
    solution = problem.exact_step.solve(x, u, problem.parameters.values)
    assert np.max(solution[3]) < 1e-7
    return np.array(solution[0]).ravel(), np.array(solution[1]).ravel()


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(4)


def test_pushing_moves_the_block_by_its_limit_surface(rng) -> None:
    problem, p, h = problems.get("pushing-obstacle", instance=5), instance_parameters("pushing-obstacle", 5), 0.04
    for fn, slid, slack in zip(rng.uniform(0, 0.3, 15), 5 * [-0.5, 0.0, 0.5], rng.uniform(0, 0.1, 15), strict=True):
        x, mu = rng.normal(size=4) * [1, 1, 1, 0.5], p["friction"]
        # The pusher slides along the edges of its cone, and sticks within.
        ft = {0.0: 0.3 * mu * fn, 0.5: mu * fn, -0.5: -mu * fn}[slid]
        rates = np.array([max(slid, 0), max(-slid, 0)])
        u = [*(np.array([mu * fn - ft, mu * fn + ft]) - 0.1 * rates), slack]
        J = np.array([[1, 0, p["zx"] / 2 * math.tan(x[3])], [0, 1, -p["zx"] / 2]])
        R = np.array([[math.cos(x[2]), -math.sin(x[2]), 0], [math.sin(x[2]), math.cos(x[2]), 0], [0, 0, 1]])
        move = R @ np.diag([1, 1, p["c"] ** -2]) @ J.T @ [fn, ft]
        expected = x + h * np.array([*move, rates[0] - rates[1]])
        found, lam = exact_step(problem, x, u)
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(lam, rates, atol=1e-6)
        cost = problem.cost_terms(x, u, 0, rates, problem.parameters.values)[0]
        assert float(cost) == pytest.approx(1e-2 * (fn**2 + ft**2) + 2 * slack, rel=1e-9)
        reach = p["r"] + max(p["zx"], p["zy"]) + 0.01
        clear = (x[0] - p["ox"]) ** 2 + (x[1] - p["oy"]) ** 2 + slack - reach**2
        np.testing.assert_allclose(row(problem, "obstacle", x, u, rates), clear, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("name", "drag", "h"), [("discs-swap", 2.0, 0.05), ("discs-around", 0.0, 2 / 30)])
def test_discs_that_meet_keep_their_momentum_and_move_on_together(name: str, drag: float, h: float) -> None:
    problem, masses = problems.get(name), np.array([2.0, 2.0, 1.0, 1.0])
    x, u = np.array([0, 0, 0.55, 0, 2.0, 0.3, -1.0, 0.1]), np.array([3.0, -1.0])
    after, lam = exact_step(problem, x, u)
    speeds = x[4:].reshape(2, 2)
    dragged = [drag * v / np.linalg.norm(v + 0.1) for v in speeds]
    smooth = h * (np.array([*u, 0, 0]) - np.ravel(dragged))
    normal = np.array([-1.0, 0, 1, 0])
    np.testing.assert_allclose(masses * (after[4:] - x[4:]), smooth + normal * lam, atol=1e-7)
    np.testing.assert_allclose(after[:4], x[:4] + h * after[4:], atol=1e-9)
    assert lam > 1 and np.linalg.norm(after[2:4] - after[:2]) == pytest.approx(0.5, abs=1e-7)
    stage, terminal = problem.cost_terms(x, u, 0, lam, problem.parameters.values)
    goal = {"discs-swap": [1, 0, -1, 0], "discs-around": [-1, 1, 0, 0]}[name]
    distance = np.dot([5, 5, 10, 10], (x[:4] - goal) ** 2)
    assert float(stage) == pytest.approx(h * (distance + 0.1 * 10))
    assert float(terminal) == pytest.approx(100 * distance)


def test_the_tether_pulls_only_where_it_is_tight_and_the_ground_carries_the_load() -> None:
    problem, h, g = problems.get("drone-tether"), 0.05, 9.81
    slack = np.array([0, 0.8, 0.3, 0, 0.1, 0.5, 1.0, 0.2, 0, 0, 1.0])
    u, thrust = np.array([6.0, 7.0]), 13.0
    after, lam = exact_step(problem, slack, u)
    assert lam[0] == pytest.approx(0, abs=1e-9) and lam[1] == pytest.approx(h * 0.35 * g)
    force = [-thrust * math.sin(0.3) - 0.1 * 0.5, thrust * math.cos(0.3) - g - 0.1 * 1.0, 0.22 * 1.0 - 0.05 * 0.2]
    v = slack[5:8] + h * np.array(force) / [1, 1, 0.05]
    np.testing.assert_allclose(after, [*(slack[:3] + h * v), 0, 0.1, *v, 0, 0, 1.05], atol=1e-8)
    tight = np.array([0.0, 1.05, 0, 0, 0.1, 0, 2.0, 0, 0, 0, 0])
    after, lam = exact_step(problem, tight, u)
    assert lam[0] > 0.3 and lam[1] == 0 and after[4] > 0.1
    assert np.hypot(*(after[:2] - after[3:5])) == pytest.approx(0.95, abs=1e-7)
    # Contact is internal: the sum of momenta changes by gravity, thrust and drag alone.
    momentum = after[6] + 0.35 * after[9] - 2.0
    assert momentum == pytest.approx(h * (thrust - 1.35 * g - 0.1 * 2.0), abs=1e-7)


@pytest.mark.parametrize(
    ("time", "xd", "zd", "zl"),
    [
        (0, 0, 1.05, 0.1),
        (1.25, 0, 2.55, 1.6),
        (2.5, 2, 2.55, 1.6),
        (3.75, 4, 2.55, 1.6),
        (4.375, 4, 1.5, 0.85),
        (5, 4, 0.45, 0.1),
    ],
)
def test_the_drones_reference_runs_through_its_corners(time: float, xd: float, zd: float, zl: float) -> None:
    pose = np.array(ca.DM(reference(ca.SX(time), ca.SX(5.0)))).ravel()
    np.testing.assert_allclose(pose, [xd, zd, 0, xd, zl], atol=1e-12)


def test_the_arm_of_push_recovery_moves_by_lagranges_equations(rng) -> None:
    problem, h, m, g = problems.get("push-recovery"), 0.04, (1.0, 0.01), 9.81

    def points(q):
        bob = np.array([-np.sin(q[0]), np.cos(q[0])])
        return bob, bob + q[1] * np.array([np.cos(q[0]), np.sin(q[0])])

    def lagrangian(q, v):
        step = 1e-5
        rates = [(a - b) / (2 * step) for a, b in zip(points(q + step * v), points(q - step * v), strict=True)]
        kinetic = sum(mass * rate @ rate / 2 for mass, rate in zip(m, rates, strict=True))
        return kinetic - sum(mass * g * point[1] for mass, point in zip(m, points(q), strict=True))

    def slope(function, at):
        return np.array([(function(at + e) - function(at - e)) / 2e-4 for e in 1e-4 * np.eye(2)])

    for _ in range(5):
        q, v, u = rng.normal(size=2) * [0.1, 0.1], rng.normal(size=2), rng.normal(size=2)
        after, lam = exact_step(problem, [*q, *v, 0.3], u)
        assert not lam[:6].any()  # The last two are slips, which a cone without force leaves open.

        def momentum(pose, rate):
            return slope(lambda w: lagrangian(pose, w), rate)

        mass = np.array([momentum(q, e) for e in np.eye(2)]).T
        drift = (momentum(q + 1e-4 * v, v) - momentum(q - 1e-4 * v, v)) / 2e-4
        force = slope(lambda pose, v=v: lagrangian(pose, v), q) - drift + [u[0] + u[1], u[0] + u[1]]
        v_next = np.linalg.solve(mass + 10 * h * np.eye(2), mass @ v + h * force)
        np.testing.assert_allclose(after, [*(q + h * v_next), *v_next, 0.34], rtol=2e-4, atol=2e-4)


@pytest.mark.costly
def test_a_plan_for_the_second_instance_of_cartpole_costs_no_more_than_the_published_ones() -> None:
    solution = solve(problems.get("cartpole-friction", instance=2), contact="exact", effort="quick")
    published = {row.solver: row.cost for row in published_results("cartpole-friction") if row.instance == 2}
    assert solution.success and solution.referee.survives
    assert 0.9 * published["ipddp2"] < solution.cost < (1 + 2e-4) * published["ipddp2"]
    assert solution.cost < published["ipopt"]


def test_states_of_a_step_of_pushing_are_those_of_its_residual(rng) -> None:
    problem = problems.get("pushing-obstacle")
    x, u = rng.normal(size=4) * 0.3, np.array([0.05, -0.02, 0.0])
    after, lam = exact_step(problem, x, u)
    np.testing.assert_allclose(after, next_state(problem, x, u, lam), atol=1e-9)
