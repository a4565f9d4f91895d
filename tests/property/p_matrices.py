"""Random P-matrices of several kinds, drawn from a seed."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

KINDS = ("symmetric", "nonsymmetric", "dominant", "triangular")


def p_matrix(kind: str, n: int, rng: np.random.Generator) -> np.ndarray:
    """Return a P-matrix (n, n) that is positive definite or, for the last two kinds, usually not."""
    square = rng.normal(size=(n, n))
    if kind == "symmetric":
        return square @ square.T + 10 ** rng.uniform(-3, 0) * np.eye(n)
    if kind == "nonsymmetric":
        skew = rng.normal(size=(n, n))
        return 0.1 * square @ square.T + 0.1 * np.eye(n) + 3 * (skew - skew.T)
    if kind == "dominant":
        np.fill_diagonal(square, 0)
        square /= np.maximum(1e-9, np.abs(square).sum(axis=1, keepdims=True))
        return (0.95 * square + np.eye(n)) * 10 ** rng.uniform(-1, 1, (n, 1))
    # A triangular matrix with a positive diagonal and its unknowns permuted.
    order = rng.permutation(n)
    return (np.triu(2 * square, 1) + np.diag(10 ** rng.uniform(-0.5, 0.5, n)))[np.ix_(order, order)]


def problems(largest: int) -> st.SearchStrategy[tuple[np.ndarray, np.ndarray, np.random.Generator]]:
    """Draw ``(z, F, rng)`` with 1 to ``largest`` contacts."""

    def build(kind: str, n: int, seed: int, size: float):
        rng = np.random.default_rng(seed)
        F = p_matrix(kind, n, rng)
        return 10**size * rng.normal(size=n), F, rng

    return st.builds(
        build,
        st.sampled_from(KINDS),
        st.integers(1, largest),
        st.integers(0, 2**32 - 1),
        st.floats(-2, 1),
    )
