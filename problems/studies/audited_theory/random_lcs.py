"""Seeded random complementarity systems, their softened solutions, and bounds on the slope."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from dynamics.contact import Barrier
from dynamics.systems import ParameterTable, entries, lcs
from dynamics.systems.lcs import is_p_matrix
from problems.studies.shared.sampled_step import SampledStep

KINDS = ("symmetric", "P-matrix")


def random_p_matrix(rng: np.random.Generator, n: int, kind: str) -> np.ndarray:
    """Draw a P-matrix (n, n): symmetric positive definite, or that plus a skew part, rescaled.

    Positive scalings of rows and columns keep the P property, not definiteness.
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
    """Solutions at k points: ``lam`` and ``gap`` (k, n), ``slope`` = dlam/dz (k, n, n)."""

    lam: np.ndarray
    gap: np.ndarray
    slope: np.ndarray


def solve(z: np.ndarray, F: np.ndarray, mu: np.ndarray) -> Softened:
    """Solve ``lam (z + F lam) = mu`` for z (k, n), F (k, n, n), mu (k,) by the barrier law."""
    n = z.shape[1]
    found = _solver(n)(z, np.zeros((1, 1)), {"F": F}, mu=mu)
    return Softened(found.lam, found.gap, found.lam_by_x)


@cache
def _solver(n: int) -> SampledStep:
    """Return the step ``x+ = lam`` of the system whose state is z; F is made of parameters."""
    none, one = np.zeros((n, n)), np.eye(n)
    table = ParameterTable(entries("F", one))
    system = lcs("random", A=none, B=np.zeros((n, 1)), C=one, D=one, E=np.zeros((n, 1)),
                 F=table["F"], parameters=table)  # fmt: skip
    return SampledStep(Barrier(mu=1.0).close(system))


def norms(matrices: np.ndarray) -> np.ndarray:
    """Spectral norms of (k, n, n)."""
    return np.linalg.norm(matrices, 2, axis=(1, 2))


def theorem_4_5(reach: np.ndarray, F: np.ndarray, mu: np.ndarray, sign: int) -> np.ndarray:
    """Bound of abs, thm. 4.5 with l(mu) *equal* to its lower bound; C = D = I, A = B = E = 0.

    ``n² |I|_F² l``, ``l = e/mu + 1/|F| + sign e sqrt(1/mu² + 2/(e mu |F|))``,
    ``e = reach²/(2 |F|²)`` with ``reach`` (k,) the largest |z| of the domain, on which the bound is
    one of the slope; printed with sign +1, derived correctly it is -1.
    """
    n, size = F.shape[1], np.linalg.norm(F, axis=(1, 2))
    e = reach**2 / (2 * size**2)
    inverse, rest = 1 / mu, 2 / (e * mu * size)
    root = np.sqrt(inverse**2 + rest)
    if sign < 0:
        # The sum cancels; this is the same number.
        return n**3 * rest / (size * (inverse + root) ** 2)
    return n**3 * (e * inverse + 1 / size + e * root)


def pointwise_4_5(lam: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """The same with ``l = |diag(lam)|_F²/mu`` at the point itself, from the theorem's proof."""
    n = lam.shape[1]
    return n**2 * n * np.sum(lam**2, axis=1) / mu


def definite_bound(F: np.ndarray) -> np.ndarray:
    """``1/lambda_min(S)``, S the symmetric part of F; infinite where S is not definite."""
    least = np.linalg.eigvalsh((F + F.transpose(0, 2, 1)) / 2)[:, 0]
    return np.where(least > 0, 1 / np.where(least > 0, least, 1), np.inf)


def theorem_5_1(z: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """Bound of abs, thm. 5.1 for z > 0: ``|I|_F² n mu sum 1/z_i²``."""
    n = z.shape[1]
    return n * n * mu * np.sum(1 / z**2, axis=1)


def corrected_5_1(z: np.ndarray, F: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """``min(1/lambda_min(S), n² mu / min z²)`` for z > 0 and S definite, else infinite."""
    n, definite = z.shape[1], definite_bound(F)
    near = n**2 * mu / np.min(z, axis=1) ** 2
    return np.where(np.isfinite(definite), np.minimum(definite, near), np.inf)


def printed_a26(lam: np.ndarray, gap: np.ndarray, F: np.ndarray) -> np.ndarray:
    """dlam/dz by abs, eq. A.26, which couples no contacts: ``-lam_i/(gap_i + lam_i F_ii)``."""
    diagonal = np.diagonal(F, axis1=1, axis2=2)
    own = -lam / (gap + lam * diagonal)
    return own[:, :, None] * np.eye(lam.shape[1])
