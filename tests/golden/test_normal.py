"""Expressions of the normal distribution agree with arithmetic in sixty digits."""

from __future__ import annotations

from decimal import Decimal, localcontext

import casadi as ca
import numpy as np
import pytest

from dynamics.contact.normal import expected_excess, normal_pdf

PI = Decimal("3.14159265358979323846264338327950288419716939937510582097494459230781640628620899")
# Points at every tenth, on both sides of the change from one form to the other, and at random.
GRID = np.concatenate(
    [
        np.arange(-80, 385) / 10,
        [1 - 1e-9, 1 + 1e-9, 4.5, 5 - 1e-9, 5 + 1e-9],
        np.random.default_rng(0).uniform(-8, 38.4, 400),
    ]
)


def exact(t: float) -> tuple[float, float, float]:
    """Return ``E max(0, w - t)``, P(w > t) and pdf(t).

    Up to 6 they are from the series ``P(w > t) = 1/2 - pdf sum t^(2k+1) / (2k+1)!!``, with enough
    digits for its cancellation; beyond from Laplace's continued fraction.
    """
    with localcontext() as context:
        context.prec = 60
        x = Decimal(float(t))
        pdf = (-x * x / 2).exp() / (2 * PI).sqrt()
        if x <= 6:
            term = total = x
            for k in range(1, 400):
                term *= x * x / (2 * k + 1)
                total += term
            tail = Decimal("0.5") - pdf * total
            return float(pdf - x * tail), float(tail), float(pdf)
        fraction = x
        for level in range(400, 1, -1):
            fraction = x + level / fraction
        # tail = pdf / (t + 1/f), f the fraction from level 2 on
        return (float(pdf / (1 + x * fraction)), float(pdf * fraction / (1 + x * fraction)), float(pdf))


@pytest.fixture(scope="module")
def compared() -> tuple[np.ndarray, np.ndarray]:
    """Return computed and exact values, (points, 3) each: excess, minus its slope, its curvature."""
    t = ca.SX.sym("t")
    value = expected_excess(t)
    slope = ca.gradient(value, t)
    f = ca.Function("f", [t], [ca.vertcat(value, -slope, ca.gradient(slope, t))])
    ours = np.array([f(point) for point in GRID])[:, :, 0]
    return ours, np.array([exact(point) for point in GRID])


def test_the_reference_agrees_with_itself():
    """The series and the fraction agree where both are accurate."""
    series = exact(6.0)
    beyond = exact(np.nextafter(6.0, 7))
    np.testing.assert_allclose(series, beyond, rtol=1e-13)


@pytest.mark.parametrize(("order", "bound"), [(0, 2e-15), (1, 3e-15), (2, 1e-12)])
def test_excess_and_its_derivatives_keep_their_digits(compared, order, bound):
    """The relative error is within a bound, wherever the exact value is a normal floating-point number.

    The curvature of the direct form, t <= 1, is pdf (1 - t² + t²), so that at t = -8 rounding is
    multiplied by 64, and the derivative of erf adds the rounding of t², again times 64.
    """
    ours, wanted = compared
    kept = wanted[:, order] > 1e-300
    np.testing.assert_allclose(ours[kept, order], wanted[kept, order], rtol=bound)
    assert kept.sum() > 0.9 * len(kept)
    if order == 2:
        kept &= GRID >= 0
        np.testing.assert_allclose(ours[kept, order], wanted[kept, order], rtol=2e-14)


def test_the_density_keeps_its_digits():
    t = ca.SX.sym("t")
    f = ca.Function("f", [t], [normal_pdf(t), ca.gradient(normal_pdf(t), t)])
    got = np.array([[float(v) for v in f(point)] for point in GRID])
    pdf = np.array([exact(point)[2] for point in GRID])
    kept = pdf > 1e-300
    np.testing.assert_allclose(got[kept, 0], pdf[kept], rtol=2e-15)
    np.testing.assert_allclose(got[kept, 1], -(GRID * pdf)[kept], rtol=4e-15)


@pytest.mark.parametrize("t", [38.5, 39.0, 40.0, 1e3])
def test_below_the_smallest_number_there_is_zero(t):
    assert 0 <= float(expected_excess(ca.SX(t))) < 1e-300
