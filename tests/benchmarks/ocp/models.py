"""The five named problems and a random LCS, written by hand as in a user's script.

Nothing here is imported from `problems`: numbers and equations are typed again, so that equal costs
also check the named problems.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from dynamics.systems import is_p_matrix

Relation = Callable[[ca.MX, ca.MX, ca.MX, ca.MX], tuple[ca.MX, ca.MX]]


@dataclass(frozen=True)
class Model:
    """A problem: ``relation(x, u, x_next, lam)`` gives residual and gap; ``stage(x, u, du)`` the cost."""

    name: str
    nx: int
    nu: int
    nlam: int
    N: int
    x0: list[float]
    u_max: float
    relation: Relation
    stage: Callable[[ca.MX, ca.MX, ca.MX], ca.MX]
    terminal: Callable[[ca.MX], ca.MX]
    u_before: list[float]


def wall_1d(N: int = 30) -> Model:
    h = 0.1

    def relation(x, u, x_next, lam):
        residual = ca.vertcat(x_next[0] - x[0] - h * x_next[1], x_next[1] - x[1] - u - lam)
        return residual, x_next[0]

    def stage(x, u, _):
        return (x[0] + 0.5) ** 2 + 0.1 * x[1] ** 2 + 0.01 * u**2

    def terminal(x):
        return 10 * (x[0] + 0.5) ** 2

    return Model("wall-1d", 2, 1, 1, N, [1, 0], 1.0, relation, stage, terminal, [0])


def push_1d(N: int = 20) -> Model:
    h, M, K = 0.1, 1.0, 100.0

    def relation(x, u, x_next, lam):
        residual = ca.vertcat(M / h * (x_next[0] - x[0]) - lam, h * K * (x_next[1] - u) + lam)
        return residual, x_next[0] - x_next[1] - 0.2

    def stage(x, _, du):
        return (x[0] - 1) ** 2 + 0.1 * du**2

    def terminal(x):
        return 100 * (x[0] - 1) ** 2

    return Model("push-1d", 2, 1, 1, N, [0, -0.5], 2.0, relation, stage, terminal, [-0.5])


def push_disc(N: int = 20) -> Model:
    h, M, K, reach = 0.1, 1.0, 50.0, 0.6
    goal = ca.DM([1, 0.5])

    def relation(x, u, x_next, lam):
        between = x[:2] - x[2:]
        distance = ca.norm_2(between)
        n = between / distance
        moved, pushed = x_next[:2] - x[:2], x_next[2:] - x[2:]
        residual = ca.vertcat(M / h * moved - n * lam, h * K * (x_next[2:] - u) + n * lam)
        return residual, distance - reach + ca.dot(n, moved - pushed)

    def stage(x, _, du):
        return 0.01 * ca.sumsqr(x[:2] - goal) + 0.1 * ca.sumsqr(du)

    def terminal(x):
        return 10 * ca.sumsqr(x[:2] - goal)

    start = [0, 0, -1, 0.2]
    return Model("push-disc", 4, 2, 1, N, start, 3.0, relation, stage, terminal, [-1, 0.2])


def ball_bounce(N: int = 40) -> Model:
    h, m, g = 0.05, 1.0, 9.81
    goal = ca.DM([2, 0.5])

    def relation(x, u, x_next, lam):
        push = h * (u - ca.vertcat(0, m * g)) + ca.vertcat(0, lam)
        residual = ca.vertcat(x_next[:2] - x[:2] - h * x_next[2:], m * (x_next[2:] - x[2:]) - push)
        return residual, x_next[1]

    def stage(_, u, __):
        return 0.01 * h * ca.sumsqr(u)

    def terminal(x):
        return 100 * ca.sumsqr(x[:2] - goal) + ca.sumsqr(x[2:])

    return Model("ball-bounce", 4, 2, 1, N, [0, 1, 1, -6], 15.0, relation, stage, terminal, [0, 0])


def cart_walls(N: int = 50) -> Model:
    h, mc, mp, length, g, wall, k = 0.04, 1.0, 0.1, 0.5, 9.81, 0.35, 100.0
    A, B, C = np.zeros((4, 4)), np.zeros((4, 1)), np.zeros((4, 2))
    A[0, 2] = A[1, 3] = 1
    A[2, 1], A[3, 1] = g * mp / mc, g * (mc + mp) / (length * mc)
    B[2], B[3] = 1 / mc, 1 / (length * mc)
    C[3] = [-1 / (length * mp), 1 / (length * mp)]
    Q = np.diag([10, 50, 1, 5])

    def relation(x, u, x_next, lam):
        residual = x_next - x - h * (A @ x_next + B @ u + C @ lam)
        tip = x_next[0] + length * x_next[1]
        return residual, lam / k + wall + ca.vertcat(-tip, tip)

    def stage(x, u, _):
        return ca.bilin(Q, x) + 0.1 * u**2

    def terminal(x):
        return 100 * ca.sumsqr(x)

    start = [0.1, 0.2, 0.5, 2.0]
    return Model("cart-walls", 4, 1, 2, N, start, 4.0, relation, stage, terminal, [0])


@dataclass(frozen=True)
class Matrices:
    """A linear complementarity system of 10 states, 3 inputs and 6 contacts, and its start."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    E: np.ndarray
    F: np.ndarray
    d: np.ndarray
    x0: np.ndarray


def random_matrices(seed: int = 7) -> Matrices:
    """Draw a damped system whose contacts push back, with an unsymmetric P-matrix F."""
    random = np.random.default_rng(seed)
    h, nx, nu, n = 0.1, 10, 3, 6
    spin = random.standard_normal((nx, nx))
    A = np.eye(nx) + h * (0.5 * (spin - spin.T) - 0.2 * np.eye(nx))
    B = h * random.standard_normal((nx, nu))
    D = random.standard_normal((n, nx)) / np.sqrt(nx)
    C = h * (D.T + 0.3 * random.standard_normal((nx, n)))
    E = 0.1 * random.standard_normal((n, nu))
    root, skew = random.standard_normal((n, n)), random.standard_normal((n, n))
    F = 0.1 * (root @ root.T / n + 0.5 * np.eye(n) + 0.2 * (skew - skew.T))
    assert is_p_matrix(F)
    d, x0 = random.uniform(0.05, 0.3, n), random.standard_normal(nx)
    return Matrices(A, B, C, D, E, F, d, x0)


def random_lcs(N: int = 100) -> Model:
    m = random_matrices()

    def relation(x, u, x_next, lam):
        residual = x_next - (m.A @ x + m.B @ u + m.C @ lam)
        return residual, m.D @ x + m.E @ u + m.F @ lam + m.d

    def stage(x, u, _):
        return 0.1 * ca.sumsqr(x) + 0.01 * ca.sumsqr(u)

    def terminal(x):
        return 10 * ca.sumsqr(x)

    start = m.x0.tolist()
    return Model("lcs-10-3-6", 10, 3, 6, N, start, 5.0, relation, stage, terminal, [0] * 3)


MODELS: dict[str, Callable[..., Model]] = {
    "wall-1d": wall_1d,
    "push-1d": push_1d,
    "push-disc": push_disc,
    "ball-bounce": ball_bounce,
    "cart-walls": cart_walls,
    "lcs-10-3-6": random_lcs,
}
