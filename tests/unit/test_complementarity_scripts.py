"""The scripts of examples/complementarity are certified, and their answers are confirmed without complementarity."""

from __future__ import annotations

import runpy
from functools import cache
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import linprog, minimize

FOLDER = Path(__file__).parents[2] / "examples" / "complementarity"
SCRIPTS = sorted(path.stem for path in FOLDER.glob("*.py"))


@cache
def ran(name: str) -> SimpleNamespace:
    """Run a script; return its variables, and ``of``, the value of an expression, once the answer is certified."""
    variables = SimpleNamespace(**runpy.run_path(str(FOLDER / f"{name}.py")))
    report = variables.sol.report
    assert report.success and report.certificate.stationarity == "B"
    variables.of = variables.sol.value
    return variables


def test_there_are_ten_scripts_and_each_states_complementarity() -> None:
    assert len(SCRIPTS) == 10
    for name in SCRIPTS:
        text = (FOLDER / f"{name}.py").read_text()
        assert "complements(" in text and "Before:" in text and "ocp.opti(opti).solve()" in text


def convex_minimum(opti: ca.Opti) -> float:
    """Return the minimum of a convex quadratic program, infinity if it is infeasible."""
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "tol": 1e-10})
    try:
        return float(opti.solve().value(opti.f))
    except RuntimeError:
        return np.inf


def cart_cost(s: SimpleNamespace, impact: int) -> float:
    """Return the least effort if the right wall acts at one step and the left one at the last."""
    opti = ca.Opti()
    q, v, u, kick = (opti.variable(n) for n in (s.N + 1, s.N + 1, s.N, 2))
    opti.subject_to([q[0] == 0, v[0] == 1.5, q[s.N] == -0.5, v[s.N] == 0, kick >= 0])
    for k in range(s.N):
        wall = -kick[0] * (k == impact) + kick[1] * (k == s.N - 1)
        opti.subject_to(s.m * (v[k + 1] - v[k]) == s.h * u[k] + wall)
        opti.subject_to(q[k + 1] == q[k] + s.h * v[k + 1])
    opti.subject_to(opti.bounded(-s.wall, q, s.wall))
    opti.subject_to(q[impact + 1] == s.wall)
    opti.minimize(s.h * ca.sumsqr(u))
    return convex_minimum(opti)


@pytest.mark.costly
def test_the_cart_uses_the_wall_at_the_best_step() -> None:
    s = ran("cart_between_walls")
    q, right, left = (s.of(part) for part in (s.q, s.right, s.left))
    assert np.all(np.minimum(right, s.wall - q[1:]) < 1e-6) and np.all(np.minimum(left, q[1:] + s.wall) < 1e-6)
    costs = [cart_cost(s, step) for step in range(2, 12)]
    assert s.of(s.opti.f) == pytest.approx(min(costs), rel=1e-5)
    assert np.flatnonzero(right > 1e-6).tolist() == [2 + int(np.argmin(costs))]


def hopper_cost(s: SimpleNamespace, flying: np.ndarray) -> float:
    """Return the least cost if the ground acts in all steps but those of the mask (N,); the program is convex."""
    opti = ca.Opti()
    height, speed, force = opti.variable(s.N + 1), opti.variable(s.N + 1), opti.variable(s.N)
    opti.subject_to([height[0] == s.rest, speed[0] == 0, height[s.N] == s.rest, speed[s.N] == 0])
    opti.subject_to([force[s.N - 1] == s.m * s.g, height[s.N // 2] >= 0.9, force >= 0, force <= 40])
    for k in range(s.N):
        opti.subject_to(speed[k + 1] == speed[k] + s.h * (force[k] / s.m - s.g))
        opti.subject_to(height[k + 1] == height[k] + s.h * speed[k + 1])
        opti.subject_to(height[k + 1] >= 0.2)
        opti.subject_to(force[k] == 0 if flying[k] else height[k + 1] <= s.rest)
    opti.minimize(s.h * ca.sumsqr(force))
    return convex_minimum(opti)


@pytest.mark.costly
def test_the_hopper_flies_as_a_ball_does_and_pushes_as_little_as_possible() -> None:
    """Its contacts cost least among those that differ in one step beside a change."""
    s = ran("hopper")
    y, v, f = (s.of(part) for part in (s.y, s.v, s.f))
    flying = f < 1e-6
    np.testing.assert_allclose(np.diff(v)[flying], -s.g * s.h, atol=1e-6)
    assert f.sum() == pytest.approx(s.N * s.m * s.g) and y[s.N // 2] >= 0.9 - 1e-7
    assert np.all(flying[y[1:] > s.rest + 1e-6])
    cost = s.of(s.opti.f)
    assert cost == pytest.approx(hopper_cost(s, flying), rel=1e-5)
    changes = np.flatnonzero(np.diff(flying))
    for k in {*changes.tolist(), *(changes + 1).tolist()} - {s.N - 1}:
        other = flying.copy()
        other[k] = not other[k]
        assert hopper_cost(s, other) >= cost - 1e-3


def test_the_leader_sells_what_maximises_its_profit_in_equilibrium() -> None:
    s = ran("stackelberg")

    def followers(x: float) -> np.ndarray:
        y = [0.0, 0.0, 0.0]
        for _ in range(60):
            for i in range(3):
                y[i] = min(max((s.a - x - sum(y) + y[i] - s.cost[i]) / 2, 0), s.capacity[i])
        return np.array(y)

    grid = np.linspace(0, 10, 201)
    profit = [x * (s.a - x - followers(x).sum() - 1) for x in grid]
    assert -s.of(s.opti.f) == pytest.approx(max(profit), abs=1e-4)
    assert s.of(s.x) == pytest.approx(grid[int(np.argmax(profit))], abs=0.05)
    np.testing.assert_allclose(s.of(s.y), followers(s.of(s.x)), atol=1e-6)


@pytest.mark.costly
def test_the_elastic_net_is_the_best_of_a_grid_of_weights() -> None:
    s = ran("elastic_net")

    def fit(l1: float, l2: float) -> np.ndarray:
        """Coordinate descent."""
        w, gram, right = np.zeros(5), s.A.T @ s.A, s.A.T @ s.train
        for _ in range(300):
            for j in range(5):
                r = right[j] - gram[j] @ w + gram[j, j] * w[j]
                w[j] = np.sign(r) * max(abs(r) - l1, 0) / (gram[j, j] + l2)
        return w

    def error(l1: float, l2: float) -> float:
        return float(np.mean((s.B @ fit(l1, l2) - s.held_out) ** 2))

    w, l1, l2 = s.of(s.w), s.of(s.l1), s.of(s.l2)
    np.testing.assert_allclose(w, fit(l1, l2), atol=1e-6)
    assert np.array_equal(np.abs(w) > 1e-6, s.truth != 0)
    assert s.of(s.opti.f) == pytest.approx(error(l1, l2), rel=1e-6)
    grid = [error(a, b) for a in np.linspace(0.01, 20, 30) for b in (0.01, 0.5, 2.0, 8.0, 20.0)]
    assert s.of(s.opti.f) <= min(grid) + 1e-9


def test_the_gas_comes_from_the_compressor_through_the_open_valve() -> None:
    """With s from the storage: valve open, p0 = 30 - 2 s² + (3 - s)²; closed, s = 2 and p0 = 2."""
    s = ran("gas_network")
    stored = np.linspace(0, 2, 2001)
    is_open = 30 - s.k3 * stored**2 + s.k1 * (3 - stored) ** 2 + 20 * stored
    feasible = 30 - s.k3 * stored**2 - s.k2 * 4 >= 20 - 1e-12
    best = min(is_open[feasible].min(), 1 + s.k1 + 20 * 2)
    assert s.of(s.opti.f) == pytest.approx(best, abs=1e-5) == pytest.approx(39.0, abs=1e-5)
    assert s.of(s.valve) == pytest.approx(2, abs=1e-5) and s.of(s.drop) == pytest.approx(0, abs=1e-6)


@pytest.mark.costly
def test_the_capacitor_is_the_smallest_that_keeps_the_voltage() -> None:
    """The rectifier is simulated, V = max(|source|, C V / (C + h / R)), and C found by bisection."""
    s = ran("ideal_diodes")

    def voltages(C: float) -> np.ndarray:
        V = 10.0
        for _ in range(5):
            values = [V := max(abs(e), V * C / (C + 1e3 * s.h / s.R)) for e in s.source]
        return np.array(values)

    low, high = 0.01, 10.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if voltages(middle).min() >= 8 else (middle, high)
    assert s.of(s.C) == pytest.approx(high, rel=1e-6)
    np.testing.assert_allclose(s.of(s.V), voltages(high), atol=1e-5)


def test_the_toll_leads_to_the_least_total_time() -> None:
    s = ran("traffic_equilibrium")

    def total(a: float, b: float) -> float:
        c = s.demand - a - b
        return a * (10 * (a + c) + a + 50) + b * (10 * (b + c) + b + 50) + c * (10 * (a + c) + 10 * (b + c) + c + 10)

    grid = np.linspace(0, 6, 61)
    best = min(total(a, b) for a, b in product(grid, grid) if a + b <= 6 + 1e-9)
    assert s.of(s.total) == pytest.approx(best, abs=1e-4) == pytest.approx(6 * 83, abs=1e-4)
    assert s.of(s.toll) == pytest.approx(13, abs=1e-3), "the least toll that closes the shortcut"


@pytest.mark.costly
def test_identified_weights_fit_as_well_as_a_direct_search_finds() -> None:
    s = ran("identification")

    def response(weight: np.ndarray) -> np.ndarray:
        """Alternate between the two inputs, each at its minimum within the bounds."""
        u = np.zeros((2, 4))
        for _ in range(60):
            for i, w in ((0, weight[1]), (1, 1.0)):
                u[i] = np.clip(-weight[0] * (s.states + u[1 - i]) / (weight[0] + w), -1, 1)
        return u

    def misfit(logs: np.ndarray) -> float:
        return float(np.sum((response(np.exp(logs)) - s.observed) ** 2))

    np.testing.assert_allclose(s.of(s.u), response(s.of(s.weight)), atol=1e-5)
    starts = ((0.0, 0.0), (0.0, 1.0), (1.0, 0.0))
    searched = min(minimize(misfit, start, method="Nelder-Mead", options={"xatol": 1e-7}).fun for start in starts)
    assert s.of(s.opti.f) == pytest.approx(searched, rel=1e-4)
    assert np.any(np.abs(s.of(s.u)) > 1 - 1e-6), "a bound is active"


@pytest.mark.costly
def test_the_volatility_reproduces_the_price_of_the_option() -> None:
    """The obstacle problem at this volatility is solved by projected Gauss-Seidel."""
    s = ran("optimal_stopping")
    n, variance = s.nodes - 2, s.of(s.variance)
    diffusion, drift = 0.5 * variance * s.S**2 / s.dS**2, s.rate * s.S / (2 * s.dS)
    lower, diagonal, upper = diffusion - drift, 2 * diffusion + s.rate, diffusion + drift
    value = s.payoff[1:-1].copy()
    for _ in range(s.steps):
        later = value.copy()
        for _ in range(2000):
            before = value.copy()
            for i in range(n):
                below = value[i - 1] if i else s.payoff[0]
                above = value[i + 1] if i + 1 < n else 0.0
                waiting = (later[i] + s.dt * (lower[i] * below + upper[i] * above)) / (1 + s.dt * diagonal[i])
                value[i] = max(waiting, s.payoff[1 + i])
            if np.abs(value - before).max() < 1e-11:
                break
    np.testing.assert_allclose(s.of(s.V)[:, -1], value, atol=1e-5)
    assert s.S[9] == 100.0 and value[9] == pytest.approx(7.5, abs=1e-4)


@pytest.mark.costly
def test_the_brake_stops_the_block_with_the_least_push() -> None:
    """Friction is at its limit while the block moves: for each number of steps the least push is a linear program.

    Its variables are the inputs and the friction that is needed to stop in the last step.
    """
    s = ran("friction_brake")
    friction, v = s.of(s.friction), s.of(s.v)
    assert np.abs(friction).max() <= s.limit + 1e-6
    np.testing.assert_allclose(friction[v[1:] > 1e-6], -s.limit, atol=1e-5)
    best = np.inf
    for moving in range(1, s.N):
        # Speeds after each step are sums of the accelerations; the last speed is zero.
        speeds = s.h / s.m * np.tril(np.ones((moving, moving)))
        by_force = np.hstack([speeds, -speeds[:, -1:]])
        slowed = speeds[:, :-1] @ np.full(moving - 1, s.limit)
        result = linprog(
            np.append(np.full(moving, s.h), 0.0),
            A_ub=-by_force,
            b_ub=-slowed,
            A_eq=np.vstack([by_force[-1], s.h * by_force.sum(axis=0)]),
            b_eq=[slowed[-1], 1 + s.h * slowed.sum()],
            bounds=[(0, 6)] * moving + [(0, s.limit)],
        )
        best = min(best, result.fun if result.success else np.inf)
    assert s.of(s.opti.f) == pytest.approx(best, rel=1e-5)
