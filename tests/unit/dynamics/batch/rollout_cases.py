"""Small systems through contact for the tests of rollouts."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.batch import RolloutPolicy
from dynamics.contact import ContactLaw, Step
from dynamics.systems import ContactSystem, lcs

H = 0.05


def wall() -> ContactSystem:
    """Return the system of a unit mass before a wall at 0, with state (position, velocity) and a force as input."""
    return lcs(
        "wall",
        A=[[1, H], [0, 1]],
        B=[[H * H], [H]],
        C=[[H], [1]],
        D=[[1, H]],
        E=[[H * H]],
        F=[[H]],
    )


def four_contact_matrices(seed: int = 0) -> dict[str, np.ndarray]:
    """Draw the matrices of a stable system of 6 states, 2 inputs and 4 contacts; F is a P-matrix, not symmetric."""
    nx, nu, n = 6, 2, 4
    rng = np.random.default_rng(seed)
    G, skew = rng.standard_normal((2, n, n))
    return {
        "A": 0.8 * np.linalg.qr(rng.standard_normal((nx, nx)))[0],
        "B": rng.standard_normal((nx, nu)),
        "C": 0.1 * rng.standard_normal((nx, n)),
        "D": rng.standard_normal((n, nx)),
        "E": rng.standard_normal((n, nu)),
        "F": G @ G.T / n + 0.5 * np.eye(n) + 0.3 * (skew - skew.T),
        "d": 0.2 * np.ones(n),
    }


def four_contacts() -> ContactSystem:
    """Return the linear complementarity system of `four_contact_matrices`."""
    return lcs("four contacts", **four_contact_matrices())


def closed(system: ContactSystem, law: ContactLaw) -> tuple[Step, ca.Function, ca.Function]:
    """Return the step under a law, a quadratic stage cost, and a terminal cost with the goal x = 1."""
    step = law.close(system)
    x, u, p = system.x, system.u, step.p.vector
    stage = ca.Function("stage", [x, u, p], [0.1 * ca.sumsqr(u) + 0.01 * ca.sumsqr(x)])
    return step, stage, ca.Function("terminal", [x, p], [5 * ca.sumsqr(x - 1)])


def reference(
    step: Step, stage: ca.Function, terminal: ca.Function, horizon: int, policy: RolloutPolicy
) -> ca.Function:
    """Return the rollout unrolled in CasADi, a function from (x0, theta, p, w) to cost and gradient by theta.

    theta is (n_theta, horizon or 1), w is (nu, horizon); contact is differentiated through the
    step's explicit map, independently of the batch engine's adjoint.
    """
    nx, nu = step.system.nx, step.system.nu
    x0, p = ca.MX.sym("x0", nx), ca.MX.sym("p", len(step.p))
    theta = ca.MX.sym("theta", policy.n_theta, horizon if policy.per_step else 1)
    w = ca.MX.sym("w", nu, horizon)
    x, cost = x0, ca.MX(0)
    for t in range(horizon):
        u = policy.law(x, theta[:, t if policy.per_step else 0]) + w[:, t]
        cost += stage(x, u, p)
        x = step.map(x, u, p)[0]
    cost += terminal(x, p)
    return ca.Function("reference", [x0, theta, p, w], [cost, ca.gradient(cost, theta)])
