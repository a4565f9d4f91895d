"""Gains shared by scenarios: agreement with dense optima, with expected costs by moments, and their limits."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from ocp.problem.rollout import Gains
from ocp.solve.shared_gains import Deviations, Expansion, shared_gains

N, NX, NU = 6, 2, 1
A = np.array([[1.0, 0.3], [0.2, 0.9]])
B = np.array([[0.05], [0.4]])
Q, R, Q_END = np.diag([1.0, 0.3]), np.array([[0.5]]), np.diag([4.0, 2.0])
GOAL = np.array([0.7, -0.2])
NO_DAMPING, SIZES = np.zeros((NU, NU)), np.ones(NX)
CERTAIN = Deviations(*np.zeros((3, NX, NX)))
ZERO_GAINS = Gains(np.zeros((N, NU, NX)), np.zeros((N, NU)))


def linear_scenario(gains: Gains, start: np.ndarray, mass: float = 1.0, goal: np.ndarray = GOAL) -> Expansion:
    """A closed loop of x+ = A x + B u / mass with the cost of distances to the goal, and its exact expansion."""
    x, u = np.empty((N + 1, NX)), np.empty((N, NU))
    x[0] = start
    for t in range(N):
        u[t] = gains.K[t] @ x[t] + gains.k[t]
        x[t + 1] = A @ x[t] + B @ u[t] / mass
    hessian = np.block([[Q, np.zeros((NX, NU))], [np.zeros((NU, NX)), R]])
    gradient = np.concatenate([(x[:-1] - goal) @ Q, u @ R], axis=1)
    dynamics = np.tile(np.hstack([A, B / mass]), (N, 1, 1))
    free = np.ones((N, NU), bool)
    return Expansion(x, u, free, dynamics, gradient, np.tile(hessian, (N, 1, 1)), Q_END @ (x[-1] - goal), Q_END)


def best_inputs(start: np.ndarray) -> np.ndarray:
    """Inputs (N,) of least cost from a start to the origin, from the normal equations of all of them at once."""
    powers = [np.linalg.matrix_power(A, t) for t in range(N + 1)]
    by_input = np.zeros(((N + 1) * NX, N))
    for t in range(1, N + 1):
        for j in range(t):
            by_input[t * NX : (t + 1) * NX, j] = (powers[t - 1 - j] @ B).ravel()
    weights = np.kron(np.eye(N + 1), Q)
    weights[-NX:, -NX:] = Q_END
    free_motion = np.concatenate([power @ start for power in powers])
    normal = by_input.T @ weights @ by_input + R[0, 0] * np.eye(N)
    return -np.linalg.solve(normal, by_input.T @ weights @ free_motion)


def test_of_starts_that_mirror_each_other_the_gains_are_optimal_for_each() -> None:
    starts = [sign * axis for axis in np.eye(NX) for sign in (1.0, -1.0)]
    scenarios = [linear_scenario(ZERO_GAINS, start, goal=np.zeros(NX)) for start in starts]
    gains = shared_gains(scenarios, ZERO_GAINS, CERTAIN, NO_DAMPING, SIZES)
    assert gains.k == pytest.approx(0, abs=1e-7)
    for start in starts:
        closed_loop = linear_scenario(gains, start)
        assert closed_loop.u.ravel() == pytest.approx(best_inputs(start), abs=1e-6)


MASSES, START = (0.7, 1.0, 1.4), np.array([1.0, 0.0])
UNCERTAIN = Deviations(np.diag([0.02, 0.01]), np.diag([1e-3, 2e-3]), np.diag([1e-3, 1e-3]))


def expected_cost(parameters: np.ndarray) -> float:
    """Mean expected cost over masses under gains (N, nu, nx + 1), by second moments of (x - goal, 1)."""
    gains = parameters.reshape(N, NU, NX + 1)
    total = 0.0
    for mass in MASSES:
        moments = np.zeros((NX + 1, NX + 1))
        distance = np.append(START - GOAL, 1.0)
        moments += np.outer(distance, distance)
        moments[:NX, :NX] += UNCERTAIN.start
        for t in range(N):
            feedback = gains[t].copy()
            feedback[:, NX] += feedback[:, :NX] @ GOAL
            noise = feedback[:, :NX] @ UNCERTAIN.measurement @ feedback[:, :NX].T
            total += 0.5 * (np.trace(Q @ moments[:NX, :NX]) + np.trace(R @ (feedback @ moments @ feedback.T + noise)))
            step = np.eye(NX + 1)
            step[:NX, :NX], step[:NX, NX] = A, A @ GOAL - GOAL
            step[:NX] += B / mass @ feedback
            moments = step @ moments @ step.T
            moments[:NX, :NX] += B @ noise @ B.T / mass**2 + UNCERTAIN.step
        total += 0.5 * np.trace(Q_END @ moments[:NX, :NX])
    return total / len(MASSES)


def parameters_of(gains: Gains) -> np.ndarray:
    return np.concatenate([gains.K, gains.k[:, :, None]], axis=2).ravel()


def slope(parameters: np.ndarray) -> np.ndarray:
    changes = 1e-6 * np.eye(len(parameters))
    return np.array([(expected_cost(parameters + d) - expected_cost(parameters - d)) / 2e-6 for d in changes])


def test_a_fixed_point_minimises_the_expected_cost_over_masses_starts_and_noise() -> None:
    gains, improve = ZERO_GAINS, partial(shared_gains, deviations=UNCERTAIN, damping=NO_DAMPING, sizes=SIZES)
    costs = [expected_cost(parameters_of(gains))]
    for _ in range(60):
        gains = improve([linear_scenario(gains, START, mass) for mass in MASSES], gains)
        costs.append(expected_cost(parameters_of(gains)))
    at_start, at_end = (np.abs(slope(parameters_of(point))).max() for point in (ZERO_GAINS, gains))
    assert at_end < 1e-6 * at_start
    nominal, certain = ZERO_GAINS, ZERO_GAINS
    for _ in range(60):
        nominal = improve([linear_scenario(nominal, START)], nominal)
        certain = shared_gains(
            [linear_scenario(certain, START, m) for m in MASSES], certain, CERTAIN, NO_DAMPING, SIZES
        )
    assert costs[-1] < min(costs[0], *(expected_cost(parameters_of(other)) for other in (nominal, certain)))


def test_damping_shortens_the_change_of_inputs_and_limits_stop_it() -> None:
    scenario = linear_scenario(ZERO_GAINS, START)
    inputs = []
    for damping in (0.0, 1.0, 1e9):
        gains = shared_gains([scenario], ZERO_GAINS, UNCERTAIN, damping * np.eye(NU), SIZES)
        inputs.append(np.abs(linear_scenario(gains, START).u).max())
    assert inputs[0] > inputs[1] > 1e6 * inputs[2]
    limited = scenario._replace(free=scenario.free & (np.arange(N)[:, None] != 2))
    gains = shared_gains([limited], ZERO_GAINS, UNCERTAIN, np.eye(NU), SIZES)
    assert np.abs(gains.K[2]).max() < 1e-9 < 1e-3 < np.abs(gains.K[1]).max()
