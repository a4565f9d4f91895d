"""Linear complementarity problems have the solutions that enumeration of their active sets gives."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from dynamics.batch.complementarity import interpreted_complementarity, linear_complementarity
from dynamics.batch.engines.compiler import CompilerError, find_compiler

LEAST_EIGENVALUE = 0.1


def tolerance(n: int) -> float:
    """Return the largest error of a solution whose n products are below 1e-8.

    With slacks s of an approximate and s* of the exact solution, ``(lam - lam*)' F (lam - lam*)`` is
    ``(lam - lam*)' (s - s*) <= lam' s``, since none of the four is negative; F has eigenvalues of at least 0.1.
    """
    return float(np.sqrt(n * 1e-8 / LEAST_EIGENVALUE))


def problems(n: int, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return unsymmetric positive definite matrices F (count, n, n) and offsets z (count, n)."""
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(2, count, n, n))
    return A @ A.transpose(0, 2, 1) + B - B.transpose(0, 2, 1) + LEAST_EIGENVALUE * np.eye(n), rng.normal(
        size=(count, n)
    )


def enumerated(F: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return the only lam with ``0 <= lam ⟂ z + F lam >= 0``."""
    for active in product((False, True), repeat=len(z)):
        lam, on = np.zeros(len(z)), np.array(active)
        lam[on] = np.linalg.solve(F[np.ix_(on, on)], -z[on])
        if lam.min() >= 0 and (F @ lam + z).min() >= -1e-12:
            return lam
    raise AssertionError("the matrix is not positive definite")


@pytest.mark.parametrize("solve", [linear_complementarity, interpreted_complementarity])
def test_solutions_are_those_of_enumeration(solve) -> None:
    F, z = problems(4, 50, 0)
    for matrix, vector, lam in zip(F, z, solve(F, z, np.ones((50, 4), dtype=bool)), strict=True):
        np.testing.assert_allclose(lam, enumerated(matrix, vector), atol=tolerance(4))


@pytest.mark.parametrize("solve", [linear_complementarity, interpreted_complementarity])
def test_pairs_outside_the_mask_have_no_effect_and_a_problem_without_solution_is_nan(solve) -> None:
    F, z = problems(6, 20, 1)
    mask = np.random.default_rng(2).random(z.shape) < 0.6
    expected = [enumerated(f[np.ix_(on, on)], v[on]) for f, v, on in zip(F, z, mask, strict=True)]
    F[~(mask[:, :, None] & mask[:, None, :])] = 7.0
    # With z < 0 and F = 0 there is no solution.
    F[3], z[3] = 0.0, -1.0
    lam = solve(np.where(mask[:, :, None] & mask[:, None, :], F, 0.0), np.where(mask, z, 0.0), mask)
    for k, (on, solution) in enumerate(zip(mask, expected, strict=True)):
        if k == 3:
            assert np.isnan(lam[k]).all()
        else:
            np.testing.assert_allclose(lam[k, on], solution, atol=tolerance(6))
            assert not lam[k, ~on].any()


def test_compiled_and_interpreted_solutions_agree_to_the_tolerance_of_both() -> None:
    try:
        find_compiler()
    except CompilerError:
        pytest.skip("no C compiler")
    F, z = problems(24, 200, 3)
    everything = np.ones(z.shape, dtype=bool)
    compiled, interpreted = (s(F, z, everything) for s in (linear_complementarity, interpreted_complementarity))
    assert np.isfinite(interpreted).all()
    np.testing.assert_allclose(compiled, interpreted, atol=2 * tolerance(24))
