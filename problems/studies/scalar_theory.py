"""Checks of single-contact propositions, of lemmas on estimators, and of growth over a horizon."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from dynamics.batch import Gaussian, RolloutFunction, RolloutPolicy, open_loop
from dynamics.contact import Adaptive, Barrier, Exact, Step
from dynamics.systems import lcs
from problems.registry import get
from problems.studies.noise import averaged_exact, gaussian, printed_kappa, student
from problems.studies.scalar_contact import scalar_contact

Q23 = 0.430727299295
"""Quantile of the standard normal at 2/3."""


def smoothing_pairs(rng: np.random.Generator, n: int) -> dict[str, np.ndarray]:
    """Random (F, scale, z), n of each: softened solutions beside quadratures and printed forms.

    ``barrier``, ``gaussian``: the laws' lam less E S_0(z + w); ``mass``: integral of rho as prop.
    5.2 prints it; ``printed``, ``true``: kappa of eq. 5.1 and the Gaussian expectation; ``bias``,
    ``bound``: slope error of thm. 5.4 and its bound at delta = 0, where it is least.
    """
    F, scale = 10 ** rng.uniform(-1, 1, (2, n))
    z = scale * rng.uniform(-2, 2, n)
    mu = scale**2 / (2 * F)
    soft = scalar_contact(Barrier(mu=1.0), z, F, mu=mu).lam
    gauss = scalar_contact(Adaptive(sigma=1.0), z, F, sigma=scale)
    heavy = [averaged_exact(at, f, student(f, m)) for at, f, m in zip(z, F, mu, strict=True)]
    true = np.array(
        [averaged_exact(at, f, gaussian(s)) for at, f, s in zip(z, F, scale, strict=True)]
    )
    return {
        "barrier": soft - heavy,
        "gaussian": gauss.lam - true,
        "mass": _printed_mass(F, mu),
        "printed": printed_kappa(z, scale),
        "true": true,
        "bias": np.abs(gauss.slope - np.where(z < 0, -1 / F, 0)),
        "bound": 1 / F + (1 / np.sqrt(np.pi)) / (scale * Q23),
        "F": F,
    }


def _printed_mass(F: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """Integral of S_mu'' over z, where prop. 5.2 has a density, (n,)."""
    half = np.geomspace(1e-5, 1e5, 4001)
    grid = np.concatenate((-half[::-1], half))
    spread = np.sqrt(F * mu)[:, None] * grid
    repeat = len(grid)
    found = scalar_contact(
        Barrier(mu=1.0), spread.ravel(), np.repeat(F, repeat), mu=np.repeat(mu, repeat)
    )
    return np.trapezoid(found.curvature.reshape(spread.shape), spread, axis=1)


def empirical_bias_pairs(rng: np.random.Generator, n: int) -> dict[str, np.ndarray]:
    """Random discrete vectors: variance, the bound of lemma III.4 and the sharp one, (n,) each.

    The event holds all outcomes but one; beta is the probability of that one, Delta as defined.
    """
    rows = []
    for _ in range(n):
        size, d = rng.integers(2, 6), rng.integers(1, 4)
        p = rng.dirichlet(np.full(size, 0.5))
        # A rare outcome is what the lemma is about.
        z = rng.standard_normal((size, d)) * np.exp(rng.uniform(-2, 2, (size, 1)))
        beta = p[0]
        mean, inside = p @ z, p[1:] @ z[1:] / (1 - beta)
        delta = np.linalg.norm(inside - mean)
        paper = max(0.0, (1 - beta) * delta - beta * np.linalg.norm(mean)) ** 2 / beta
        rows.append((p @ np.sum((z - mean) ** 2, axis=1), paper, (1 - beta) / beta * delta**2))
    return dict(zip(("variance", "paper", "sharp"), np.transpose(rows), strict=True))


def unbiasedness(seed: int, n: int) -> dict[str, float]:
    """First- against zeroth-order mean on ``wall-1d`` under the exact law, worst of all inputs.

    ``z_score``: largest difference of the means over their joint standard error.
    """
    problem = get("wall-1d", N=15, x0=0.3)
    step = Exact().close(problem.system)
    stage, terminal = _costs(step, lambda x, u: x[0] ** 2 + 0.01 * u**2, lambda x: x[0] ** 2)
    rollout = RolloutFunction(step, stage, terminal, 15, open_loop(2, 1))
    theta, start = np.full((15, 1), -0.2), np.array([0.3, 0.0])
    at_rest = rollout(start, theta, gradient=False).cost.mean()
    found = rollout.moments(start, theta, noise=Gaussian(0.3, seed), n_samples=n, score=True,
                            baseline=float(at_rest))  # fmt: skip
    first, zeroth = found.gradient, found.zeroth
    assert first is not None and zeroth is not None
    error = np.hypot(first.standard_error, zeroth.standard_error)
    score = np.abs(first.mean - zeroth.mean) / error
    return {"z_score": float(score.max()), "components": float(score.size)}


def growth(seed: int, n: int, horizons: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """First-order variance, (len(gains), len(horizons)), of ``x+ = a x + b u`` with a far wall.

    a = b = L/sqrt(2), so that the dynamics' Lipschitz constant in (x, u) is L; the policy is
    ``u = x + theta + w``, of constant 1, the cost x² at the end.
    """
    found = np.empty((len(gains), len(horizons)))
    for row, gain in enumerate(gains):
        rate = gain / np.sqrt(2)
        system = lcs("chain", A=[[rate]], B=[[rate]], C=[[1.0]], D=[[rate]], E=[[rate]],
                     F=[[1.0]], d=[1e9])  # fmt: skip
        step = Exact().close(system)
        stage, terminal = _costs(step, lambda x, u: ca.SX(0), lambda x: x[0] ** 2)
        x, theta = ca.SX.sym("x"), ca.SX.sym("theta")
        policy = RolloutPolicy(ca.Function("shift", [x, theta], [x + theta]), per_step=False)
        for column, horizon in enumerate(horizons):
            rollout = RolloutFunction(step, stage, terminal, int(horizon), policy)
            moments = rollout.moments(np.array([1.0]), np.array([0.0]), noise=Gaussian(0.1, seed),
                                      n_samples=n).gradient  # fmt: skip
            assert moments is not None
            found[row, column] = moments.variance[0]
    return found


def _costs(
    step: Step, stage: Callable[[ca.SX, ca.SX], ca.SX], terminal: Callable[[ca.SX], ca.SX]
) -> tuple[ca.Function, ca.Function]:
    x, u = ca.SX.sym("x", step.system.nx), ca.SX.sym("u", step.system.nu)
    p = ca.SX.sym("p", len(step.p))
    return (
        ca.Function("stage", [x, u, p], [stage(x, u)]),
        ca.Function("terminal", [x, p], [terminal(x)]),
    )
