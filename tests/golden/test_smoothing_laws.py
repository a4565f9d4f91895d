"""The barrier and the adaptive law as averages over noise agree with reference numbers.

z is the gap at lam = 0, F the compliance, phi and Phi the normal density and distribution;
kappa = (sigma phi(z/sigma) - z Phi(-z/sigma)) / F, as corrected in docs/theory/errata.md.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad

from dynamics.contact import Adaptive, Barrier, ContactLaw
from dynamics.contact.adaptive import gaussian_mu
from dynamics.contact.interior_point import scalar_solution
from dynamics.systems import lcs


def by_gap(F: float, law: ContactLaw) -> ca.Function:
    """Return the function ``z -> (lam, d lam/dz, d² lam/dz²)`` of one contact under ``law``."""
    eye, zero = np.eye(1), np.zeros((1, 1))
    system = lcs("contact", A=zero, B=zero, C=eye, D=eye, E=zero, F=[[F]])
    step = law.close(system)
    z = ca.MX.sym("z")
    lam = step.map(z, 0, step.p.values)[1]
    outputs = [lam, ca.jacobian(lam, z)]
    if not law.frozen:
        outputs.append(ca.jacobian(outputs[1], z))
    return ca.Function("by_gap", [z], outputs)


# z, F, sigma, kappa, mu = kappa (z + F kappa), total derivative -Phi(-z/sigma)/F,
# frozen derivative -kappa / (z + 2 F kappa), dmu/dz = (Phi(z/s) F kappa - Phi(-z/s) (z+F kappa))/F
GAUSSIAN = [
    (
        0.3,
        2.0,
        0.5,
        0.042168183060438874,
        0.01620676624336903,
        -0.1371265588750368,
        -0.08997362159035797,
        -0.022099295950434566,
    ),
    (0.0, 1.0, 1.0, 0.3989422804014327, 0.15915494309189535, -0.5, -0.5, 0.0),
    (
        -1.0,
        1.0,
        1.0,
        1.0833154705876864,
        0.09025693822693392,
        -0.8413447460685429,
        -0.9285845526231744,
        0.10177665762878718,
    ),
    (
        2.0,
        0.11,
        0.3,
        5.135010817731611e-12,
        1.0270021635466122e-11,
        -1.1894476987320932e-10,
        -2.567505408864355e-12,
        -2.327545289288214e-10,
    ),
    (
        -0.6,
        0.5,
        0.2,
        1.2001528617268191,
        9.172871944521673e-05,
        -1.9973002039367398,
        -1.9997452953462902,
        0.0014674286066253134,
    ),
    (
        3.0,
        1.0,
        0.1,
        1.631956734091401e-200,
        4.8958702022742037e-200,
        -4.906713927148187e-198,
        -5.439855780304671e-201,
        -1.4703822214103648e-197,
    ),
]


@pytest.mark.parametrize(("z", "F", "sigma", "kappa", "mu", "total", "frozen", "dmu"), GAUSSIAN)
def test_gaussian_law(z, F, sigma, kappa, mu, total, frozen, dmu):
    symbol = ca.SX.sym("z")
    expression = gaussian_mu(symbol, F, sigma)
    law = ca.Function("mu", [symbol], [expression, ca.jacobian(expression, symbol)])
    got_mu, got_dmu = (float(value) for value in law(z))
    assert got_mu == pytest.approx(mu, rel=1e-11)
    assert got_dmu == pytest.approx(dmu, rel=1e-9, abs=1e-15)
    lam, gradient, _ = (float(v) for v in by_gap(F, Adaptive(sigma=sigma))(z))
    assert lam == pytest.approx(kappa, rel=1e-11)
    assert gradient == pytest.approx(total, rel=1e-9)
    held = by_gap(F, Adaptive(sigma=sigma, gradient="frozen"))
    assert float(held(z)[1]) == pytest.approx(frozen, rel=1e-9)


def test_the_peak_of_gaussian_mu():
    # sigma² / (2 pi F) at z = 0: 0.25 / (2 pi 2)
    assert float(gaussian_mu(ca.SX(0), ca.SX(2), 0.5)) == pytest.approx(0.019894367886486918, rel=1e-13)


# F, mu, E|w| = 2 sqrt(F mu), 90 % quantile sqrt(F mu) (2p-1)/sqrt(p (1-p)), density at 0.2:
# rho(w) = F S''(-w) = 2 F mu / (w² + 4 F mu)^1.5, Student's t with 2 degrees of freedom.
STUDENT = [
    (1.0, 0.1, 0.6324555320336759, 0.8432740427115678, 0.6852530558585537),
    (2.5, 0.03, 0.5477225575051661, 0.7302967433402214, 0.7566114050404802),
]


@pytest.mark.parametrize(("F", "mu", "mean_size", "quantile", "density"), STUDENT)
def test_the_noise_that_a_barrier_stands_for(F, mu, mean_size, quantile, density):
    law = by_gap(F, Barrier(mu=mu))

    def rho(w: float) -> float:
        return F * float(law(-w)[2])

    assert rho(0.2) == pytest.approx(density, rel=1e-10)
    # the distribution function of the noise is -F dlam/dz at -w
    assert -F * float(law(-quantile)[1]) == pytest.approx(0.9, rel=1e-12)
    assert quad(rho, -np.inf, np.inf)[0] == pytest.approx(1, rel=1e-7)
    assert 2 * quad(lambda w: w * rho(w), 0, np.inf)[0] == pytest.approx(mean_size, rel=1e-7)


def test_the_gaussian_law_has_its_curvature_at_the_kink_too():
    """E S_0(z + w) has second derivative pdf(0) / (F sigma) at z = 0, F = sigma = 1."""
    z = ca.SX.sym("z")
    lam = scalar_solution(z, ca.SX(1), gaussian_mu(z, ca.SX(1), 1.0))
    second = ca.Function("second", [z], [ca.hessian(lam, z)[0]])
    assert float(second(0.0)) == pytest.approx(0.3989422804014327, rel=1e-12)
