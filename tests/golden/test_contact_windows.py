"""Five problems solved by enumeration of the windows of contact, each a convex QP without the workbench."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from problems import spec
from problems.library import ball_bounce, cart_walls, push_1d, soft_walls, wall_1d
from tests.golden.convex import convex

Windows = Callable[[np.ndarray], float]


def windows(u: ca.SX, lam: ca.SX, gap: ca.SX, cost: ca.SX, u_max: float) -> Windows:
    """Return a function from the steps of contact to the minimum cost with contact there alone; inf if infeasible."""
    n, bound = lam.numel(), np.full(u.numel(), u_max)
    least = convex(ca.vertcat(u, lam), cost, gap)

    def best(acts: np.ndarray) -> float:
        low = np.concatenate([-bound, np.zeros(n)])
        high = np.concatenate([bound, np.where(acts, np.inf, 0.0)])
        return least(low, high, np.zeros(n), np.where(acts, 0.0, np.inf))

    return best


def wall() -> Windows:
    """Return the windows of ``m (v+ - v) = u + lam, x+ = x + h v+ >= 0`` from (x0, v0)."""
    p = wall_1d.Params()
    u, lam = ca.SX.sym("u", p.N), ca.SX.sym("lam", p.N)
    x, v, cost, gaps = ca.SX(p.x0), ca.SX(p.v0), ca.SX(0), []
    for k in range(p.N):
        cost += p.w_x * (x - p.goal_x) ** 2 + p.w_v * v**2 + p.w_u * u[k] ** 2
        v = v + (u[k] + lam[k]) / p.m
        x = x + p.h * v
        gaps.append(x)
    return windows(u, lam, ca.vertcat(*gaps), cost + p.w_end * (x - p.goal_x) ** 2, p.u_max)


def push() -> Windows:
    """Return the windows of ``M (qu+ - qu) = h lam, K (qa+ - u) = -lam / h, qu+ - qa+ >= width``."""
    p = push_1d.Params()
    u, lam = ca.SX.sym("u", p.N), ca.SX.sym("lam", p.N)
    x, before, cost, gaps = ca.SX(p.qu0), ca.SX(p.qa0), ca.SX(0), []
    for k in range(p.N):
        cost += p.w_x * (x - p.goal_x) ** 2 + p.w_du * (u[k] - before) ** 2
        before = u[k]
        x = x + p.h / p.M * lam[k]
        gaps.append(x - (u[k] - lam[k] / (p.h * p.K)) - p.width)
    return windows(u, lam, ca.vertcat(*gaps), cost + p.w_end * (x - p.goal_x) ** 2, p.u_max)


def bounce() -> Windows:
    """Return the windows of ``m (v+ - v) = h (u - (0, m g)) + (0, lam), q+ = q + h v+, y+ >= 0``."""
    p = ball_bounce.Params()
    u, lam = ca.SX.sym("u", 2, p.N), ca.SX.sym("lam", p.N)
    q, v = ca.SX([p.x0, p.y0]), ca.SX([p.vx0, p.vy0])
    gaps = []
    for k in range(p.N):
        v = v + p.h * (u[:, k] / p.m - ca.DM([0, p.g])) + ca.vertcat(0, lam[k] / p.m)
        q = q + p.h * v
        gaps.append(q[1])
    off = ca.sumsqr(q - ca.DM([p.goal_x, p.goal_y]))
    cost = p.w_u * p.h * ca.sumsqr(u) + p.w_end * off + p.w_v * ca.sumsqr(v)
    return windows(ca.vec(u), lam, ca.vertcat(*gaps), cost, p.u_max)


def walls() -> Windows:
    """Return the windows of ``(1 - h F) x+ = x + h (B u + C lam)``, ``lam / k + wall ∓ tip >= 0``."""
    p = cart_walls.Params()
    F = np.zeros((4, 4))
    F[0, 2] = F[1, 3] = 1.0
    F[2, 1], F[3, 1] = p.g * p.mp / p.mc, p.g * (p.mc + p.mp) / (p.l * p.mc)
    inverse = np.linalg.inv(np.eye(4) - p.h * F)
    B = np.array([0, 0, 1 / p.mc, 1 / (p.l * p.mc)])
    C = np.array([0, 0, 0, 1 / (p.l * p.mp)])
    u, lam = ca.SX.sym("u", p.N), ca.SX.sym("lam", 2, p.N)
    weights = ca.DM([p.w_p, p.w_theta, p.w_dp, p.w_dtheta])
    x, cost, gaps = ca.SX([p.p0, p.theta0, p.dp0, p.dtheta0]), ca.SX(0), []
    for k in range(p.N):
        cost += ca.dot(weights, x**2) + p.w_u * u[k] ** 2
        x = inverse @ (x + p.h * (B * u[k] + C * (lam[1, k] - lam[0, k])))
        tip = x[0] + p.l * x[1]
        gaps.append(lam[:, k] / p.k + p.wall + ca.vertcat(-tip, tip))
    return windows(u, ca.vec(lam), ca.vertcat(*gaps), cost + p.w_end * ca.sumsqr(x), p.u_max)


def spring() -> Windows:
    """Return the windows of ``x+ = x + h (A x + B u + C lam)``, ``lam / k + wall - tip >= 0``."""
    p = soft_walls.Params()
    A = np.zeros((4, 4))
    A[0, 2] = A[1, 3] = 1.0
    A[2, 1], A[3, 1] = p.g * p.mp / p.mc, p.g * (p.mc + p.mp) / (p.lc * p.mc)
    B = np.array([0, 0, 1 / p.mc, 1 / (p.lc * p.mc)])
    turn = -1 / (p.mc * p.lc) + p.lp * (p.mc + p.mp) / (p.mc * p.mp * p.lc**2)
    C = np.array([0, 0, -1 / p.mc + p.lp / (p.mc * p.lc), turn])
    Q = np.diag([p.w_p, p.w_theta, p.w_dp, p.w_dtheta])
    ends = np.eye(4) + p.h * A, p.h * B[:, None], Q, np.array([[p.w_u]])
    u, lam = ca.SX.sym("u", p.N), ca.SX.sym("lam", p.N)
    x, cost, gaps = ca.SX([p.p0, p.theta0, p.dp0, p.dtheta0]), ca.SX(0), []
    for k in range(p.N):
        cost += ca.bilin(Q, x) + p.w_u * u[k] ** 2
        gaps.append(lam[k] / p.k + p.wall - (x[0] - p.lp * x[1]))
        x = x + p.h * (A @ x + B * u[k] + C * lam[k])
    cost += ca.bilin(solve_discrete_are(*ends), x)
    return windows(u, lam, ca.vertcat(*gaps), cost, 1e3)


@pytest.mark.slow
def test_the_stated_value_is_the_best_of_all_windows_of_one_wall() -> None:
    """One of both walls is touched from step a to step b - 1, the other never."""
    golden, least, k = spec("cart-walls").golden["exact"], walls(), np.arange(50)
    inside = [(k >= a) & (k < b) for a in range(50) for b in range(a + 1, 51)]
    costs = [
        least(np.stack([acts * side for side in sides], axis=1).ravel())
        for acts in inside
        for sides in ((True, False), (False, True))
    ]
    assert f"all {len(costs)} windows" in golden.independent
    assert min(costs) == pytest.approx(golden.cost, rel=1e-6)


@pytest.mark.cheap_cases("push-1d-push-20-20", "soft-walls-spring-20-18")
@pytest.mark.parametrize(
    ("name", "peer", "steps", "feasible"),
    [
        ("wall-1d", wall, 30, 30),
        ("push-1d", push, 20, 20),
        ("ball-bounce", bounce, 40, 40),
        # No input moves the gaps of the first two steps: the start presses in both.
        ("soft-walls", spring, 20, 18),
    ],
)
def test_the_stated_value_is_the_best_of_all_windows_of_contact(
    name: str, peer: Callable[[], Windows], steps: int, feasible: int
) -> None:
    """There is contact from step a to step b - 1, for all a < b: zero gap there, no force elsewhere.

    At least ``feasible`` windows must be feasible, so that the test compares more than a few.
    """
    golden, least, k = spec(name).golden["exact"], peer(), np.arange(steps)
    costs = [least((k >= a) & (k < b)) for a in range(steps) for b in range(a + 1, steps + 1)]
    assert f"all {len(costs)} windows" in golden.independent
    assert np.isfinite(costs).sum() >= feasible
    assert min(costs) == pytest.approx(golden.cost, rel=1e-6)
