"""Small steps through contact for the tests of rollouts, as plain SX expressions."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np


@dataclass(frozen=True)
class Step:
    """The symbols and expressions that a rollout reads of a one-step relation."""

    x: ca.SX
    u: ca.SX
    p: ca.SX
    lam: ca.SX
    z: ca.SX
    F: ca.SX
    mu: ca.SX
    x_next: ca.SX
    exact: bool = False


def wall(mu: float | ca.SX = 1e-3, exact: bool = False, h: float = 0.05, m: float = 1.0) -> Step:
    """A point mass before a wall at 0: state (position, velocity), input a force."""
    x, u, p, lam = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("p"), ca.SX.sym("lam")
    v = x[1] + h * u / m
    return Step(
        x=x,
        u=u,
        p=p,
        lam=lam,
        z=x[0] + h * v + 0 * p,
        F=ca.SX(h / m),
        mu=ca.SX(0) if exact else p,
        x_next=ca.vertcat(x[0] + h * (v + lam / m), v + lam / m),
        exact=exact,
    )


def lcs(nx: int = 6, nu: int = 2, n: int = 4, seed: int = 0, exact: bool = False) -> Step:
    """A random linear complementarity system with a P-matrix; p is its mu."""
    rng = np.random.default_rng(seed)
    x, u, p, lam = ca.SX.sym("x", nx), ca.SX.sym("u", nu), ca.SX.sym("p"), ca.SX.sym("lam", n)
    A = 0.9 * np.linalg.qr(rng.standard_normal((nx, nx)))[0]
    B, C = rng.standard_normal((nx, nu)), 0.3 * rng.standard_normal((nx, n))
    E, H = rng.standard_normal((n, nx)), rng.standard_normal((n, nu))
    G = rng.standard_normal((n, n))
    skew = rng.standard_normal((n, n))
    F = G @ G.T / n + 0.5 * np.eye(n) + 0.3 * (skew - skew.T)
    return Step(
        x=x,
        u=u,
        p=p,
        lam=lam,
        z=ca.DM(E) @ x + ca.DM(H) @ u + 0.2,
        F=ca.SX(ca.DM(F)),
        mu=ca.SX.zeros(n) if exact else p * ca.SX.ones(n),
        x_next=ca.DM(A) @ x + ca.DM(B) @ u + ca.DM(C) @ lam,
        exact=exact,
    )


def costs(step: Step) -> tuple[ca.Function, ca.Function]:
    """A quadratic stage cost and a terminal one that aims at x = 1."""
    x, u, p = step.x, step.u, step.p
    stage = ca.Function("stage", [x, u, p], [0.1 * ca.sumsqr(u) + 0.01 * ca.sumsqr(x)])
    return stage, ca.Function("terminal", [x, p], [5 * ca.sumsqr(x - 1)])
