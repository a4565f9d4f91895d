"""The normal distribution as CasADi expressions that are accurate in the far tail too."""

from __future__ import annotations

import math
from functools import cache

import casadi as ca
import numpy as np
from numpy.polynomial import chebyshev, legendre

# Argument t above which the polynomial R(y) replaces the difference, see `expected_excess`.
_KNOT = 1.0
# Argument t at which the polynomial's variable y is zero.
_CENTRE = 4.0
# Degree of the polynomial R(y).
_DEGREE = 28


def normal_pdf(t: ca.SX) -> ca.SX:
    """Return the density of the standard normal distribution at t, with a relative error of 1e-15.

    t is split at a multiple of 1/16, whose square is exact, since rounding t² would cause an error of
    1e-13 at t = 40. The multiple is piecewise constant, so that derivatives equal those of the density.
    """
    multiple = ca.floor(16 * t) / 16
    exponent_rest = (t - multiple) * (t + multiple) / 2
    return ca.exp(-(multiple**2) / 2) * ca.exp(-exponent_rest) / math.sqrt(2 * math.pi)


def expected_excess(t: ca.SX) -> ca.SX:
    """Return ``E max(0, w - t)`` = pdf(t) - t P(w > t) for standard normal w, with a relative error of 2e-15.

    For large t the difference has a relative error that grows like t². There it is replaced by ``pdf(t) G(t)``, with

        G(t) = int_0^inf s exp(-t s - s²/2) ds = R(y) / (1 + t)²,   y = (t - 4) / (t + 4),

    which has only positive terms; R is between 1 and 1.42 for all t >= 0 and is approximated by a polynomial of
    degree 28 in y. The first two derivatives, -P(w > t) and pdf(t), are free of cancellation too.
    """
    direct = normal_pdf(t) - t * (1 - ca.erf(t / math.sqrt(2))) / 2
    tail_t = ca.fmax(t, _KNOT)
    ratio = _clenshaw(_coefficients(), (tail_t - _CENTRE) / (tail_t + _CENTRE)) / (1 + tail_t) ** 2
    return ca.if_else(t > _KNOT, normal_pdf(tail_t) * ratio, direct)


def _clenshaw(coefficients: list[float], y: ca.SX) -> ca.SX:
    """Return the sum of Chebyshev polynomials in y with these coefficients, by Clenshaw's recurrence."""
    second_next, next_value = ca.SX(0), ca.SX(0)
    for coefficient in reversed(coefficients[1:]):
        second_next, next_value = next_value, coefficient + 2 * y * next_value - second_next
    return coefficients[0] + y * next_value - second_next


def _scaled_ratio(t: np.ndarray) -> np.ndarray:
    """Return R = (1 + t)² G(t), t >= 0, by Gauss quadrature over r = (1 + t) s on 30 panels."""
    nodes, weights = legendre.leggauss(16)
    width = 1.5
    starts = width * np.arange(30)
    r = (starts[:, None] + width * (nodes + 1) / 2).ravel()
    weight = np.tile(weights * width / 2, len(starts))
    s = r / (1 + t[:, None])
    return (r * np.exp(-t[:, None] * s - s**2 / 2)) @ weight


@cache
def _coefficients() -> list[float]:
    """Return the Chebyshev coefficients of R(y)."""
    y = np.cos(np.pi * (np.arange(_DEGREE + 1) + 0.5) / (_DEGREE + 1))
    values = _scaled_ratio(_CENTRE * (1 + y) / (1 - y))
    return [float(value) for value in chebyshev.chebfit(y, values, _DEGREE)]
