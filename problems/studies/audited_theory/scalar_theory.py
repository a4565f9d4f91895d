"""Checks of single-contact propositions, of lemmas on estimators, and of growth over a horizon."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
from scipy.stats import norm

from dynamics.batch import Gaussian, RolloutFunction, RolloutPolicy, open_loop
from dynamics.contact import Exact, Step
from dynamics.systems import lcs
from problems.registry import get
from problems.studies.shared.noise import (
    averaged_exact,
    gaussian,
    least_residual,
    misfit,
    printed_kappa,
    student,
)
from problems.studies.shared.scalar_contact import barrier_contact, gaussian_contact

GROWTH_NOISE = 0.1
"""Noise of the policy in :func:`growth`, over a standard normal one."""


CONSTANTS = ((0.0, 0.0), (-0.5, 0.0), (-1.0, 0.0), (0.0, 0.5))
"""c1, c2 of eq. 5.1 at which thm. 5.4 is tried; the text leaves them open."""


def smoothing_pairs(rng: np.random.Generator, n: int) -> dict[str, np.ndarray]:
    """Random (F, scale, z), n of each: softened solutions beside quadratures and printed forms.

    ``barrier``, ``gaussian``: the laws' lam less E S_0(z + w); ``mass``: integral of rho as prop.
    5.2 prints it; ``misfit``: kappa of eq. 5.1 at its best c1, c2 less the Gaussian
    expectation over |z| <= 3 scales, over scale/F; ``bias``, ``tail``: slope error of the corrected
    law and its closed form, times F.
    """
    F, scale = 10 ** rng.uniform(-1, 1, (2, n))
    z = scale * rng.uniform(-2, 2, n)
    mu = scale**2 / (2 * F)
    soft = barrier_contact(z, F, mu).lam
    gauss = gaussian_contact(z, F, scale)
    heavy = [averaged_exact(at, f, student(f, m)) for at, f, m in zip(z, F, mu, strict=True)]
    true = [averaged_exact(at, f, gaussian(s)) for at, f, s in zip(z, F, scale, strict=True)]
    return {
        "barrier": soft - heavy,
        "gaussian": gauss.lam - true,
        "mass": _printed_mass(F, mu),
        "F": F,
        "misfit": np.array([_misfit(f, s) for f, s in zip(F, scale, strict=True)]),
        "bias": F * np.abs(gauss.slope - np.where(z < 0, -1 / F, 0)),
        "tail": norm.sf(np.abs(z) / scale),
    }


def _misfit(F: float, scale: float) -> float:
    """Misfit of eq. 5.1 over scale/F, with its sigma read as deviation or variance."""
    z = scale * np.linspace(-3, 3, 121)
    true = gaussian_contact(z, F, scale).lam
    return F / scale * min(misfit(printed_kappa(z, s), true, z) for s in (scale, scale**2))


def theorem_5_4(rng: np.random.Generator, n: int) -> dict[str, np.ndarray]:
    """Slope errors of the model softened by eq. 5.1 as printed, beside thm. 5.4's bound.

    For n random (F, sigma, z), each at every pair of :data:`CONSTANTS`: ``bias`` and ``bound``
    (len(CONSTANTS), n), for C = D = 1 and E = 0. The softened solution is the root of
    ``lam (z + F lam) = kappa (z + F kappa)`` that is not negative, with its total derivative;
    where there is none (mu < 0) the bias is infinite.
    """
    F, sigma = 10 ** rng.uniform(-1, 1, (2, n))
    z = sigma * rng.uniform(-2, 2, n)
    delta = [least_residual(at, f, s) for at, f, s in zip(z, F, sigma, strict=True)]
    exact, step = np.where(z < 0, -1 / F, 0), 1e-5 * sigma
    bias, bound = np.empty((2, len(CONSTANTS), n))
    for row, (c1, c2) in enumerate(CONSTANTS):

        def solution(at: np.ndarray, c1: float = c1, c2: float = c2) -> np.ndarray:
            kappa = printed_kappa(at, sigma) + c1 * at + c2
            mu = kappa * (at + F * kappa)
            return np.where(mu >= 0, np.maximum(kappa, -at / F - kappa), np.nan)

        slope = (solution(z + step) - solution(z - step)) / (2 * step)
        bias[row] = np.nan_to_num(np.abs(slope - exact), nan=np.inf)
        varsigma = 1 / np.sqrt(np.pi) + c2
        bound[row] = 1 / F + (12 * np.array(delta) + varsigma) / (sigma * norm.ppf(2 / 3))
    return {"bias": bias, "bound": bound}


def _printed_mass(F: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """Integral of S_mu'' over z, where prop. 5.2 has a density, (n,)."""
    half = np.geomspace(1e-5, 1e5, 4001)
    grid = np.concatenate((-half[::-1], half))
    spread = np.sqrt(F * mu)[:, None] * grid
    repeat = len(grid)
    found = barrier_contact(spread.ravel(), np.repeat(F, repeat), np.repeat(mu, repeat))
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
    ``u = x + theta + s w``, of constant sqrt(1 + s²) in (x, w), s = :data:`GROWTH_NOISE` and w
    standard normal; the cost at the end is sqrt(s² + x²), of constant 1. It starts at x = 0, where
    the side to which noise throws it, and so the sign of the gradient, is open.
    """
    found = np.empty((len(gains), len(horizons)))
    for row, gain in enumerate(gains):
        rate = gain / np.sqrt(2)
        system = lcs("chain", A=[[rate]], B=[[rate]], C=[[1.0]], D=[[rate]], E=[[rate]],
                     F=[[1.0]], d=[1e9])  # fmt: skip
        step = Exact().close(system)
        stage, terminal = _costs(
            step, lambda x, u: ca.SX(0), lambda x: ca.sqrt(GROWTH_NOISE**2 + x[0] ** 2)
        )
        x, theta = ca.SX.sym("x"), ca.SX.sym("theta")
        policy = RolloutPolicy(ca.Function("shift", [x, theta], [x + theta]), per_step=False)
        for column, horizon in enumerate(horizons):
            rollout = RolloutFunction(step, stage, terminal, int(horizon), policy)
            moments = rollout.moments(np.array([0.0]), np.array([0.0]), n_samples=n,
                                      noise=Gaussian(GROWTH_NOISE, seed)).gradient  # fmt: skip
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
