"""Bounds from two papers on contact slopes, gradient estimators and variance, and random tests of these bounds.

Theorems 4.4 to 5.4 are from Zhang et al. 2023, lemmas with the number III from Suh et al. 2022.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np
from scipy.stats import norm

from dynamics.batch import Gaussian, RolloutFunction, RolloutPolicy, open_loop
from dynamics.contact import Barrier, Exact, Step
from dynamics.systems import ParameterTable, lcs, matrix_parameters
from dynamics.systems.lcs import is_p_matrix
from problems.registry import get
from problems.studies.shared.sampled_step import (
    SampledStep,
    affine_misfit,
    averaged_exact,
    barrier_contact,
    gaussian_contact,
    gaussian_density,
    least_residual,
    printed_kappa,
    student_density,
)

GROWTH_NOISE = 0.1
"""Standard deviation of the policy's noise in :func:`variance_growth`."""


CONSTANTS = ((0.0, 0.0), (-0.5, 0.0), (-1.0, 0.0), (0.0, 0.5))
"""Pairs of constants (c1, c2) in eq. 5.1 for which thm. 5.4 is tested; the paper does not state their values."""


def smoothing_pairs(rng: np.random.Generator, n: int) -> dict[str, np.ndarray]:
    """Return errors of softened single contacts at n random compliances F, noise scales and gaps z, (n,) each.

    ``barrier``, ``gaussian``: lam of the law minus E S_0(z + w) by quadrature; ``mass``: integral of
    the density in prop. 5.2 as printed; ``misfit``: largest error of eq. 5.1 at its best c1, c2 for
    |z| <= 3 scales, divided by scale/F; ``bias``: slope error of the corrected adaptive law times F;
    ``tail``: closed form of ``bias``.
    """
    F, scale = 10 ** rng.uniform(-1, 1, (2, n))
    z = scale * rng.uniform(-2, 2, n)
    mu = scale**2 / (2 * F)
    soft = barrier_contact(z, F, mu).lam
    gauss = gaussian_contact(z, F, scale)
    heavy = [averaged_exact(gap, f, student_density(f, m)) for gap, f, m in zip(z, F, mu, strict=True)]
    true = [averaged_exact(gap, f, gaussian_density(s)) for gap, f, s in zip(z, F, scale, strict=True)]
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
    """Return the error of eq. 5.1 divided by scale/F, with sigma read as standard deviation or variance.

    The smaller of the two errors is returned.
    """
    z = scale * np.linspace(-3, 3, 121)
    true = gaussian_contact(z, F, scale).lam
    return F / scale * min(affine_misfit(printed_kappa(z, s), true, z) for s in (scale, scale**2))


def theorem_5_4(rng: np.random.Generator, n: int) -> dict[str, np.ndarray]:
    """Return slope errors of the contact softened by eq. 5.1 as printed, and the bound of thm. 5.4.

    The slope errors ``bias`` and the bounds ``bound``, (len(CONSTANTS), n) each, are for n random
    (F, sigma, z) and every pair of :data:`CONSTANTS`, with C = D = 1 and E = 0. The softened solution is
    the nonnegative root of ``lam (z + F lam) = mu``, ``mu = kappa (z + F kappa)``, and its slope is the total
    derivative by z; if there is no root (mu < 0), the error is infinite.
    """
    F, sigma = 10 ** rng.uniform(-1, 1, (2, n))
    z = sigma * rng.uniform(-2, 2, n)
    delta = [least_residual(gap, f, s) for gap, f, s in zip(z, F, sigma, strict=True)]
    exact, step = np.where(z < 0, -1 / F, 0), 1e-5 * sigma
    bias, bound = np.empty((2, len(CONSTANTS), n))
    for row, (c1, c2) in enumerate(CONSTANTS):

        def solution(gap: np.ndarray, c1: float = c1, c2: float = c2) -> np.ndarray:
            kappa = printed_kappa(gap, sigma) + c1 * gap + c2
            mu = kappa * (gap + F * kappa)
            return np.where(mu >= 0, np.maximum(kappa, -gap / F - kappa), np.nan)

        slope = (solution(z + step) - solution(z - step)) / (2 * step)
        bias[row] = np.nan_to_num(np.abs(slope - exact), nan=np.inf)
        varsigma = 1 / np.sqrt(np.pi) + c2
        bound[row] = 1 / F + (12 * np.array(delta) + varsigma) / (sigma * norm.ppf(2 / 3))
    return {"bias": bias, "bound": bound}


def _printed_mass(F: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """Return the integral (n,) of S_mu'' over z, which is 1 if S_mu'' is a density as prop. 5.2 states."""
    positive_grid = np.geomspace(1e-5, 1e5, 4001)
    grid = np.concatenate((-positive_grid[::-1], positive_grid))
    spread = np.sqrt(F * mu)[:, None] * grid
    repeat = len(grid)
    softened = barrier_contact(spread.ravel(), np.repeat(F, repeat), np.repeat(mu, repeat))
    return np.trapezoid(softened.curvature.reshape(spread.shape), spread, axis=1)


def empirical_bias_pairs(rng: np.random.Generator, n: int) -> dict[str, np.ndarray]:
    """Return variances (n,) of n random discrete distributions, and two bounds (n,) from lemma III.4.

    ``paper`` is the bound as printed, and ``sharp`` the sharp bound. The event of the lemma contains all outcomes
    except one of probability beta; Delta is the distance of the mean over the event from the mean over all outcomes.
    """
    rows = []
    for _ in range(n):
        size, d = rng.integers(2, 6), rng.integers(1, 4)
        p = rng.dirichlet(np.full(size, 0.5))
        # The excluded outcome should be rare.
        z = rng.standard_normal((size, d)) * np.exp(rng.uniform(-2, 2, (size, 1)))
        beta = p[0]
        mean, inside = p @ z, p[1:] @ z[1:] / (1 - beta)
        delta = np.linalg.norm(inside - mean)
        paper = max(0.0, (1 - beta) * delta - beta * np.linalg.norm(mean)) ** 2 / beta
        rows.append((p @ np.sum((z - mean) ** 2, axis=1), paper, (1 - beta) / beta * delta**2))
    return dict(zip(("variance", "paper", "sharp"), np.transpose(rows), strict=True))


def compare_orders(seed: int, n: int) -> dict[str, float]:
    """Compare first- and zeroth-order gradients of ``wall-1d`` under the exact law, over all inputs.

    ``z_score`` is the largest difference of the two means divided by its standard error, and ``components``
    the number of inputs.
    """
    problem = get("wall-1d", N=15, x0=0.3)
    step = Exact().close(problem.system)
    stage, terminal = _costs(step, lambda x, u: x[0] ** 2 + 0.01 * u**2, lambda x: x[0] ** 2)
    rollout = RolloutFunction(step, stage, terminal, 15, open_loop(2, 1))
    theta, start = np.full((15, 1), -0.2), np.array([0.3, 0.0])
    at_rest = rollout(start, theta, gradient=False).cost.mean()
    moments = rollout.moments(start, theta, noise=Gaussian(0.3, seed), n_samples=n, score=True, baseline=float(at_rest))
    first, zeroth = moments.gradient, moments.zeroth
    assert first is not None and zeroth is not None
    error = np.hypot(first.standard_error, zeroth.standard_error)
    score = np.abs(first.mean - zeroth.mean) / error
    return {"z_score": float(score.max()), "components": float(score.size)}


def variance_growth(seed: int, n: int, horizons: np.ndarray, gains: np.ndarray) -> np.ndarray:
    """Return variances (len(gains), len(horizons)) of first-order gradients of ``x+ = a x + b u``, far from its wall.

    With a = b = L/sqrt(2), the Lipschitz constant of the dynamics in (x, u) is the gain L. The policy
    ``u = x + theta + s w`` has the Lipschitz constant sqrt(1 + s²) in (x, w), where s is
    :data:`GROWTH_NOISE` and w is standard normal; the Lipschitz constant of the terminal cost
    sqrt(s² + x²) is 1. From the start x = 0, the noise determines the sign of the final x and of the gradient.
    """
    variances = np.empty((len(gains), len(horizons)))
    for row, gain in enumerate(gains):
        rate = gain / np.sqrt(2)
        system = lcs("chain", A=[[rate]], B=[[rate]], C=[[1.0]], D=[[rate]], E=[[rate]], F=[[1.0]], d=[1e9])
        step = Exact().close(system)
        stage, terminal = _costs(step, lambda x, u: ca.SX(0), lambda x: ca.sqrt(GROWTH_NOISE**2 + x[0] ** 2))
        x, theta = ca.SX.sym("x"), ca.SX.sym("theta")
        policy = RolloutPolicy(ca.Function("shift", [x, theta], [x + theta]), per_step=False)
        for column, horizon in enumerate(horizons):
            rollout = RolloutFunction(step, stage, terminal, int(horizon), policy)
            moments = rollout.moments(
                np.array([0.0]), np.array([0.0]), n_samples=n, noise=Gaussian(GROWTH_NOISE, seed)
            ).gradient
            assert moments is not None
            variances[row, column] = moments.variance[0]
    return variances


def _costs(
    step: Step, stage: Callable[[ca.SX, ca.SX], ca.SX], terminal: Callable[[ca.SX], ca.SX]
) -> tuple[ca.Function, ca.Function]:
    x, u = ca.SX.sym("x", step.system.nx), ca.SX.sym("u", step.system.nu)
    p = ca.SX.sym("p", len(step.p))
    return (ca.Function("stage", [x, u, p], [stage(x, u)]), ca.Function("terminal", [x, p], [terminal(x)]))


KINDS = ("symmetric", "P-matrix")
"""Kinds of random matrices F."""


def random_p_matrix(rng: np.random.Generator, n: int, kind: str) -> np.ndarray:
    """Draw a random P-matrix (n, n) of one of the :data:`KINDS`.

    A symmetric matrix is positive definite. The other kind adds a skew part to such a matrix and rescales
    rows and columns by positive factors, which preserves the P property but not definiteness.
    """
    G = rng.standard_normal((n, n))
    symmetric = G @ G.T / n + 0.1 * np.eye(n)
    if kind == "symmetric":
        return symmetric
    skew = np.triu(rng.standard_normal((n, n)), 1)
    rows, columns = np.exp(rng.standard_normal((2, n)))
    F = rows[:, None] * (symmetric + skew - skew.T) * columns
    if not is_p_matrix(F):
        raise ValueError("a rescaled definite matrix must be a P-matrix; its scaling overflowed")
    return F


@dataclass(frozen=True)
class Softened:
    """Solutions of k softened contact problems: ``lam`` and ``gap`` (k, n), ``slope`` = dlam/dz (k, n, n)."""

    lam: np.ndarray
    gap: np.ndarray
    slope: np.ndarray


def solve_softened(z: np.ndarray, F: np.ndarray, mu: np.ndarray) -> Softened:
    """Solve ``lam (z + F lam) = mu`` for z (k, n), F (k, n, n), mu (k,) by the barrier law."""
    n = z.shape[1]
    solutions = _solver(n)(z, np.zeros((1, 1)), {"F": F}, mu=mu)
    return Softened(solutions.lam, solutions.gap, solutions.lam_by_x)


@cache
def _solver(n: int) -> SampledStep:
    """Return a solver of n contacts with gaps ``F lam + z`` as a step from the state z to lam; F is its parameter."""
    zeros, identity = np.zeros((n, n)), np.eye(n)
    table = ParameterTable(matrix_parameters("F", identity))
    system = lcs(
        "random",
        A=zeros,
        B=np.zeros((n, 1)),
        C=identity,
        D=identity,
        E=np.zeros((n, 1)),
        F=table["F"],
        parameters=table,
    )
    return SampledStep(Barrier(mu=1.0).close(system))


def spectral_norms(matrices: np.ndarray) -> np.ndarray:
    """Return the spectral norms of matrices (k, n, n)."""
    return np.linalg.norm(matrices, 2, axis=(1, 2))


def theorem_4_5(reach: np.ndarray, F: np.ndarray, mu: np.ndarray, sign: int) -> np.ndarray:
    """Return the bound (k,) of thm. 4.5 on the slope, with l(mu) *equal* to its lower bound, C = D = I, A = B = E = 0.

    ``n² |I|_F² l``, ``l = e/mu + 1/|F| + sign e sqrt(1/mu² + 2/(e mu |F|))``,
    ``e = reach²/(2 |F|²)`` with ``reach`` (k,) the largest |z| of the domain on which the slope is
    bounded. The printed theorem has ``sign`` +1, the corrected one -1.
    """
    n, size = F.shape[1], np.linalg.norm(F, axis=(1, 2))
    e = reach**2 / (2 * size**2)
    inverse, under_root = 1 / mu, 2 / (e * mu * size)
    root = np.sqrt(inverse**2 + under_root)
    if sign < 0:
        # The difference of large terms would cancel; this equal form does not.
        return n**3 * under_root / (size * (inverse + root) ** 2)
    return n**3 * (e * inverse + 1 / size + e * root)


def pointwise_4_5(lam: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """Return the bound (k,) of thm. 4.5 with ``l = |diag(lam)|_F²/mu`` at the point, as in the theorem's proof."""
    n = lam.shape[1]
    return n**2 * n * np.sum(lam**2, axis=1) / mu


def definite_bound(F: np.ndarray) -> np.ndarray:
    """Return the bound ``1/lambda_min(S)`` (k,) on the slope, S the symmetric part of F; infinite for indefinite S."""
    smallest_eigenvalue = np.linalg.eigvalsh((F + F.transpose(0, 2, 1)) / 2)[:, 0]
    return np.where(smallest_eigenvalue > 0, 1 / np.where(smallest_eigenvalue > 0, smallest_eigenvalue, 1), np.inf)


def theorem_5_1(z: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """Return the bound (k,) of thm. 5.1 on the slope for z > 0: ``|I|_F² n mu sum 1/z_i²``."""
    n = z.shape[1]
    return n * n * mu * np.sum(1 / z**2, axis=1)


def corrected_5_1(z: np.ndarray, F: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """Return the corrected bound of thm. 5.1, ``min(1/lambda_min(S), n² mu / min z²)``; infinite for indefinite S."""
    n, definite = z.shape[1], definite_bound(F)
    near_contact = n**2 * mu / np.min(z, axis=1) ** 2
    return np.where(np.isfinite(definite), np.minimum(definite, near_contact), np.inf)


def printed_a26(lam: np.ndarray, gap: np.ndarray, F: np.ndarray) -> np.ndarray:
    """Return dlam/dz by eq. A.26 of Zhang et al. 2023, without coupling: ``-lam_i/(gap_i + lam_i F_ii)``."""
    diagonal = np.diagonal(F, axis1=1, axis2=2)
    diagonal_slope = -lam / (gap + lam * diagonal)
    return diagonal_slope[:, :, None] * np.eye(lam.shape[1])
