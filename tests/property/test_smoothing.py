"""The laws are smoothings of the exact one, by quadrature, and have a known stiffness."""

from __future__ import annotations

from functools import cache
from itertools import product

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import erfcx
from scipy.stats import norm, t

from dynamics.contact import Adaptive, Barrier, Exact
from dynamics.contact.adaptive import gaussian_mu
from dynamics.contact.affine_step import lcp_solver
from dynamics.contact.interior_point import scalar_solution
from dynamics.systems import Parameter, ParameterTable, lcs
from tests.examples import settings
from tests.property.p_matrices import p_matrix

exponents = st.floats(-6, 0)
compliances = st.floats(0.05, 5)


@cache
def scalar(law: str) -> ca.Function:
    """Return ``(z, F, parameter) -> (lam, dlam/dz, d²lam/dz²)`` of one contact, by the step map."""
    table = ParameterTable([Parameter("F", 1.0)])
    eye, zero = np.eye(1), np.zeros((1, 1))
    system = lcs("contact", A=zero, B=zero, C=eye, D=eye, E=zero, F=ca.SX(table["F"]), parameters=table)
    laws = {"exact": Exact(), "barrier": Barrier(), "gaussian": Adaptive()}
    z, F, parameter = ca.MX.sym("z"), ca.MX.sym("F"), ca.MX.sym("parameter")
    p = F if law == "exact" else ca.vertcat(F, parameter)
    lam = laws[law].close(system).map(z, 0, p)[1]
    slope = ca.jacobian(lam, z)
    return ca.Function(law, [z, F, parameter], [lam, slope, ca.jacobian(slope, z)])


def value(law: str, z: float, F: float, parameter: float, order: int = 0) -> float:
    return float(scalar(law)(z, F, parameter)[order])


@pytest.mark.costly
@settings(max_examples=25)
@given(z=st.floats(-2, 2), F=compliances, exponent=st.floats(-3, 0))
def test_a_barrier_is_smoothing_by_students_t(z, F, exponent):
    mu = 10**exponent
    scale = np.sqrt(2 * F * mu)

    def integrand(s: float) -> float:  # w = -z - s, and only w < -z makes contact
        return value("exact", -s, F, 0) * t.pdf((-z - s) / scale, 2) / scale

    near = abs(z) + 20 * scale
    average = sum(quad(integrand, *part, epsabs=1e-11, limit=200)[0] for part in ((0, near), (near, np.inf)))
    assert value("barrier", z, F, mu) == pytest.approx(average, rel=2e-6)


@pytest.mark.costly
@settings(max_examples=25)
@given(z=st.floats(-2, 2), F=compliances, sigma=st.floats(0.05, 1))
def test_the_gaussian_law_is_smoothing_by_the_normal(z, F, sigma):
    def integrand(s: float) -> float:
        return value("exact", -s, F, 0) * norm.pdf((-z - s) / sigma) / sigma

    peak = max(0.0, -z)
    average = quad(integrand, 0, peak + 12 * sigma, points=[peak], epsabs=1e-14, limit=200)[0]
    assert value("gaussian", z, F, sigma) == pytest.approx(average, rel=1e-6, abs=1e-12)
    slope = value("gaussian", z, F, sigma, order=1)
    assert slope == pytest.approx(-norm.cdf(-z / sigma) / F, rel=1e-8, abs=1e-13)


def tail_mu(distance: float, sigma: float, F: float) -> float:
    """Return kappa (z + F kappa) through the scaled complementary error function."""
    r = distance / sigma
    mills = np.sqrt(np.pi / 2) * erfcx(r / np.sqrt(2))
    # 1 - r mills cancels like 1/r², so that twelve terms of its series are summed at r >= 8.
    terms = [1.0]
    for k in range(1, 12):
        terms.append(-terms[-1] * (2 * k + 1) / r**2 if r >= 8 else 0.0)
    excess = sum(terms) / r**2 if r >= 8 else 1 - r * mills
    kappa = sigma / F * np.exp(-r * r / 2) / np.sqrt(2 * np.pi) * excess
    return kappa * (distance + F * kappa)


@pytest.mark.parametrize("ratio", [0.5, 1, 2, 4, 4.999, 5.001, 6, 8, 12, 16, 20, 25, 30, 35])
@pytest.mark.parametrize("sigma", [1e-3, 0.3])
def test_the_gaussian_tail_is_accurate_in_relative_terms(ratio, sigma):
    distance, F = ratio * sigma, 0.7
    expected = tail_mu(distance, sigma, F)
    for z in (distance, -distance):  # mu is even
        got = float(gaussian_mu(ca.SX(z), ca.SX(F), sigma))
        assert got == pytest.approx(expected, rel=1e-9)
        assert got > 0


@pytest.mark.costly
@settings(max_examples=50)
@given(z=st.floats(-3, 3), F=compliances, sigma=st.floats(0.01, 1))
def test_gaussian_mu_is_even_positive_and_peaks_at_contact(z, F, sigma):
    mu, mirrored, peak = (float(gaussian_mu(ca.SX(v), ca.SX(F), sigma)) for v in (z, -z, 0.0))
    assert mu == mirrored
    assert 0 <= mu <= peak * (1 + 1e-12)
    assert peak == pytest.approx(sigma**2 / (2 * np.pi * F), rel=1e-12)


@settings(max_examples=60)
@given(z=st.floats(-3, 3), F=compliances, exponent=st.floats(-12, 0))
def test_stiffness_does_not_depend_on_mu_but_curvature_does(z, F, exponent):
    mu = 10**exponent
    assert -1 / F * (1 + 1e-9) <= value("barrier", z, F, mu, 1) <= 0
    sharpest = 1 / (4 * F**1.5 * np.sqrt(mu))
    assert 0 <= value("barrier", z, F, mu, 2) <= sharpest * (1 + 1e-9)
    assert value("barrier", 0.0, F, mu, 2) == pytest.approx(sharpest, rel=1e-9)
    assert value("barrier", 0.0, F, mu, 1) == pytest.approx(-1 / (2 * F), rel=1e-12)


@settings(max_examples=60)
@given(z=st.floats(-3, 3), F=compliances, exponent=st.floats(-14, 1))
def test_the_closed_form_neither_cancels_nor_loses_the_sign(z, F, exponent):
    mu = 10**exponent
    lam = float(scalar_solution(ca.SX(z), ca.SX(F), ca.SX(mu)))
    assert lam > 0
    # The expected value is the root in extended precision, by the form that does not cancel.
    Z, R, C = np.longdouble(z), np.longdouble(F), np.longdouble(mu)
    root = np.sqrt(Z * Z + 4 * R * C)
    expected = 2 * C / (Z + root) if z > 0 else (root - Z) / (2 * R)
    assert lam == pytest.approx(float(expected), rel=1e-14)


def lam_jacobian(F: np.ndarray, z: np.ndarray, mu: float) -> tuple[np.ndarray, np.ndarray]:
    """Return lam and d lam/dz of several contacts by the step map."""
    n = len(z)
    eye, zero = np.eye(n), np.zeros((n, n))
    system = lcs("contact", A=zero, B=np.zeros((n, 1)), C=eye, D=eye, E=np.zeros((n, 1)), F=F)
    symbol = ca.MX.sym("z", n)
    lam = Barrier(mu=mu).close(system).map(symbol, 0, mu)[1]
    values = ca.Function("d", [symbol], [lam, ca.jacobian(lam, symbol)])(z)
    return np.array(values[0]).ravel(), np.array(values[1])


@pytest.mark.costly
@settings(max_examples=25)
@given(n=st.integers(2, 6), seed=st.integers(0, 2**32 - 1), exponent=exponents)
def test_contacts_couple_in_the_jacobian(n, seed, exponent):
    rng = np.random.default_rng(seed)
    F, z, mu = p_matrix("symmetric", n, rng), rng.normal(size=n), 10**exponent
    jacobian = lam_jacobian(F, z, mu)[1]
    numerical = np.empty((n, n))
    for j in range(n):
        shift = 1e-6 * np.eye(n)[j]
        ends = [np.array(lcp_solver(n)(z + s, F, np.full(n, mu))[0]).ravel() for s in (shift, -shift)]
        numerical[:, j] = (ends[0] - ends[1]) / 2e-6
    assert np.allclose(jacobian, numerical, rtol=1e-4, atol=1e-4 * np.abs(numerical).max())


@pytest.mark.costly
def test_dropping_the_coupling_gives_another_jacobian():
    # Zhang et al. 2023, eq. A.26 as printed is diagonal, with -lam_i / (eps_i + lam_i F_ii).
    rng = np.random.default_rng(4)
    errors = []
    for _ in range(20):
        F, z = p_matrix("symmetric", 4, rng), rng.normal(size=4)
        lam, jacobian = lam_jacobian(F, z, 1e-3)
        printed = np.diag(-lam / (z + F @ lam + lam * np.diag(F)))
        errors.append(np.linalg.norm(printed - jacobian) / np.linalg.norm(jacobian))
    assert np.median(errors) > 0.1


@pytest.mark.costly
@settings(max_examples=40)
@given(n=st.integers(2, 5), seed=st.integers(0, 2**32 - 1))
def test_the_lipschitz_bound_holds_for_every_mu(n, seed):
    # ||dlam/dz|| <= 1 / lambda_min(sym F) for any mu, so that the true constant stays finite.
    rng = np.random.default_rng(seed)
    F, z = p_matrix("symmetric", n, rng), rng.normal(size=n)
    bound = 1 / np.linalg.eigvalsh(F)[0]
    sizes = [np.linalg.norm(lam_jacobian(F, z, mu)[1], 2) for mu in (1.0, 1e-3, 1e-6, 1e-9)]
    assert max(sizes) <= bound * (1 + 1e-7)


@pytest.mark.costly
@settings(max_examples=30)
@given(n=st.integers(2, 4), seed=st.integers(0, 2**32 - 1))
def test_the_bound_of_a_p_matrix_holds_for_every_mu(n, seed):
    # dlam/dz = -(I - D + D F)^-1 D with D = diag(lam / (lam + eps)); every entry is monotone in
    # every d_i (linear over linear, positive denominator), so the corners of [0, 1]^n bound it
    rng = np.random.default_rng(seed)
    F, z, eye = p_matrix("triangular", n, rng), rng.normal(size=n), np.eye(n)
    corners = [
        np.abs(np.linalg.solve(eye - np.diag(d) + np.diag(d) @ F, np.diag(d))) for d in product([0.0, 1.0], repeat=n)
    ]
    bound = np.max(corners, axis=0)
    for mu in (1.0, 1e-3, 1e-6, 1e-9):
        assert np.all(np.abs(lam_jacobian(F, z, mu)[1]) <= bound * (1 + 1e-6) + 1e-9)
