"""The path solver solves random P-matrix problems, and P-matrices are recognised."""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics.contact.affine_step import lcp_solver
from dynamics.systems import is_p_matrix
from tests.examples import settings
from tests.property.p_matrices import KINDS, p_matrix, problems


def solved(z, F, mu, exact: bool = False) -> tuple[np.ndarray, ...]:
    return tuple(np.array(out).ravel() for out in lcp_solver(len(z), exact)(z, F, mu))


def units(z, F, mu) -> tuple[np.ndarray, float]:
    """Return D and c: impulses are of the size c D, gaps of c / D, and their products of c²."""
    D = 1 / np.sqrt(np.diag(F))
    return D, max(np.max(np.abs(z * D)), np.sqrt(np.max(mu)))


@pytest.mark.costly
@settings(max_examples=200)
@given(problem=problems(16), exponent=st.floats(-12, 0), spread=st.booleans())
def test_the_path_is_followed_to_its_end(problem, exponent, spread):
    z, F, rng = problem
    n = len(z)
    mu = 10 ** (rng.uniform(-12, 0, n) if spread else np.full(n, exponent))
    lam, gap, error = solved(z, F, mu)
    D, c = units(z, F, mu)
    assert np.all(lam > 0)
    assert np.all(gap > 0)
    assert np.all(error <= 1e-10)
    assert np.max(np.abs(lam * gap - mu)) <= 1e-10 * c**2
    # z + F lam cancels to the gap, which may be off by the rounding of the sum alone.
    size = np.abs(z) + np.abs(F) @ lam
    assert np.all(np.abs(z + F @ lam - gap) <= 1e-10 * c / D + 1e-12 * size)


def enumerated(z: np.ndarray, F: np.ndarray) -> np.ndarray:
    """Return the unique solution of 0 <= lam ⟂ z + F lam >= 0, by enumeration of active sets."""
    n = len(z)
    best, least = np.zeros(n), np.inf
    for flags in product([False, True], repeat=n):
        active = np.array(flags)
        lam = np.zeros(n)
        if active.any():
            lam[active] = np.linalg.solve(F[np.ix_(active, active)], -z[active])
        worst = max(0.0, -np.min(lam), -np.min(z + F @ lam))
        if worst < least:
            best, least = lam, worst
    return best


@settings(max_examples=100)
@given(problem=problems(6))
def test_the_exact_law_agrees_with_enumeration(problem):
    z, F, _ = problem
    lam, gap, error = solved(z, F, np.zeros(len(z)), exact=True)
    D, c = units(z, F, np.zeros(1))
    expected = enumerated(z, F)
    size = max(1.0, np.max(expected / (c * D)))
    assert np.max(np.abs(lam - expected) / (c * D)) <= 1e-9 * size
    assert np.max(np.abs(lam * gap)) <= 1e-12 * c**2
    assert np.min(lam) >= 0
    assert np.min(gap) >= 0
    assert np.all(error <= 1e-10)


@settings(max_examples=30)
@given(problem=problems(8))
def test_resting_contacts_are_solved_too(problem):
    # With z = -F lam and some lam zero, strict complementarity fails at these contacts.
    _, F, rng = problem
    lam_known = rng.uniform(0, 1, len(F)) * (rng.uniform(size=len(F)) < 0.5)
    lam, gap, error = solved(-F @ lam_known, F, np.zeros(len(F)), exact=True)
    assert np.allclose(lam, lam_known, atol=1e-6 * max(1, np.linalg.norm(np.linalg.inv(F))))
    assert np.max(lam * gap) <= 1e-11
    assert np.all(error <= 1e-10)


@settings(max_examples=40)
@given(problem=problems(8), exponent=st.floats(-6, 0), factor=st.floats(-6, 6))
def test_units_do_not_matter(problem, exponent, factor):
    # For lengths times a and impulses times b, gaps scale by a, lam by b, F by a/b, mu by a b.
    z, F, _ = problem
    a, b = 10**factor, 10 ** (-factor / 2)
    mu = np.full(len(z), 10**exponent)
    here, there = solved(z, F, mu), solved(a * z, F * a / b, a * b * mu)
    assert np.allclose(there[0], b * here[0], rtol=1e-6)
    assert np.allclose(there[1], a * here[1], rtol=1e-6)


@settings(max_examples=40)
@given(problem=problems(6), exponent=st.floats(-4, 0))
def test_each_contact_keeps_to_its_own_mu(problem, exponent):
    # The order of the contacts has no meaning.
    z, F, rng = problem
    mu = 10 ** (exponent + rng.uniform(-3, 0, len(z)))
    order = rng.permutation(len(z))
    lam = solved(z, F, mu)[0]
    assert np.allclose(solved(z[order], F[np.ix_(order, order)], mu[order])[0], lam[order])


def test_failure_is_reported():
    # This is no P-matrix: the impulses of the last two contacts close each other's gaps faster than
    # they open their own.
    F = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, -2.0], [0.0, -2.0, 1.0]])
    assert not is_p_matrix(F)
    for exact in (False, True):
        error = solved(np.array([1.0, -1.0, -1.0]), F, np.full(3, 0.1), exact)[2]
        assert np.max(error[1:]) > 1e-10


def by_minors(F: np.ndarray) -> bool:
    n = len(F)
    return all(
        np.linalg.det(F[np.ix_(rows, rows)]) > 0 for size in range(1, n + 1) for rows in combinations(range(n), size)
    )


@settings(max_examples=200)
@given(n=st.integers(1, 5), seed=st.integers(0, 2**32 - 1), shift=st.floats(-0.5, 3))
def test_p_matrices_are_told_from_others_by_their_minors(n, seed, shift):
    F = np.random.default_rng(seed).normal(size=(n, n)) + shift * np.eye(n)
    assert is_p_matrix(F) == by_minors(F)


@settings(max_examples=60)
@given(kind=st.sampled_from(KINDS), n=st.integers(1, 10), seed=st.integers(0, 2**32 - 1))
def test_p_matrices_are_recognised(kind, n, seed):
    F = p_matrix(kind, n, np.random.default_rng(seed))
    assert is_p_matrix(F)
    assert not is_p_matrix(-F)
