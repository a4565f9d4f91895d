"""Coulomb friction with a slip tolerance: continuous, but first-order gradients from few samples are biased."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.systems import ParameterTable
from ocp.gradients.objective import ClosedForm
from problems.parameters import Parameters, quantity
from problems.spec import Citation

name = "coulomb"
title = "Coulomb friction, relaxed within a slip tolerance"
citation = Citation("suh2022pathologies", "Pathologies of differentiable simulators, ex. III.5")
equations = r"""
f(theta, w) = macron(H)_nu (theta + w), quad macron(H)_nu (t) = "clip"(2 t \/ nu, -1, 1), quad
  w tilde "N"(0, sigma^2)
(dif F) / (dif theta) = 2 / nu (Phi((theta + nu \/ 2) / sigma) - Phi((theta - nu \/ 2) / sigma))
"""
GAUSS_RULE = np.polynomial.legendre.leggauss(96)
"""Nodes and weights of the Gauss-Legendre rule on [-1, 1]."""
NOISE_REACH = 12.0
"""Number of standard deviations above which the weight of noise is zero in double precision."""


class Params(Parameters):
    """Parameters of ``coulomb``: theta is a sliding velocity, f friction over normal force."""

    theta: float = quantity(0.0, "m/s", "sliding velocity")
    nu: float = quantity(0.01, "m/s", "slip tolerance, the width within which f is linear", above=0)
    sigma: float = quantity(0.1, "m/s", "standard deviation of the noise on theta", above=0)


def cost(params: Params, theta: ca.SX, p: ParameterTable) -> ca.SX:
    """Return the objective of Suh et al. (2022), ex. III.5: a relaxation of the sign function, 2 H - 1."""
    inside = ca.fabs(theta) <= p["nu"] / 2
    return ca.if_else(inside, 2 * theta / p["nu"], ca.sign(theta))


def closed_form(values: dict[str, float], sigma: float) -> ClosedForm:
    """Return the exact mean F and its gradient, and means and variances of the gradient's estimators.

    With ``G(y) = y Phi(y/sigma) + sigma phi(y/sigma)``: ``F = (2/nu) (G(theta + nu/2) - G(theta - nu/2)) - 1`` and
    ``F' = (2/nu) p``, where p is the probability that the derivative is 2/nu and not zero; one sample of the
    first-order gradient has the variance ``(4/nu^2) p (1 - p)``. The paper's closed form of F and its gradient at
    nu/2 are half of the correct values, and it states 1 - p instead of p.
    """
    from scipy.stats import norm

    theta, nu = values["theta"], values["nu"]
    above, below = (theta + nu / 2) / sigma, (theta - nu / 2) / sigma
    p = _stick_probability(theta, nu, sigma)

    def G(y: float) -> float:
        return y * float(norm.cdf(y)) + float(norm.pdf(y))

    gradient = 2 / nu * p
    return ClosedForm(
        objective=2 * sigma / nu * (G(above) - G(below)) - 1,
        gradient=np.array([gradient]),
        zobg_variance=np.array([zobg_variance(theta, nu, sigma, 0.0)]),
        fobg_mean=np.array([gradient]),
        fobg_variance=np.array([4 / nu**2 * p * (1 - p)]),
    )


def zobg_variance(theta: float, nu: float, sigma: float, baseline: float) -> float:
    """Return the variance of one zeroth-order sample ``(f - b) w/sigma^2`` with a constant baseline b.

    The variance is ``E[(f - b)^2 w^2]/sigma^4 - F'^2``, in closed form where ``f = +-1``, and by Gauss quadrature on
    the linear part; the quadrature is exact up to rounding errors and has no cancellation for small nu.
    """
    from scipy.stats import norm

    low, high = (np.clip(v, -NOISE_REACH * sigma, NOISE_REACH * sigma) for v in (-theta - nu / 2, nu / 2 - theta))
    t, weights = GAUSS_RULE
    w = low + (high - low) * (t + 1) / 2
    density = norm.pdf(w / sigma) / sigma * weights * (high - low) / 2
    f = np.clip(2 * (theta + w) / nu, -1, 1)

    def tail(y: float) -> float:
        """Return the integral E[w^2; w > y] over the tail of the noise."""
        return sigma**2 * float(norm.sf(y / sigma) + y / sigma * norm.pdf(y / sigma))

    second = (1 - baseline) ** 2 * tail(high) + (1 + baseline) ** 2 * (sigma**2 - tail(low))
    second += float(np.sum((f - baseline) ** 2 * w**2 * density))
    return second / sigma**4 - (2 / nu * _stick_probability(theta, nu, sigma)) ** 2


def _stick_probability(theta: float, nu: float, sigma: float) -> float:
    """Return the probability that the noised velocity is within the slip tolerance, where f is linear."""
    from scipy.stats import norm

    return float(norm.cdf((theta + nu / 2) / sigma) - norm.cdf((theta - nu / 2) / sigma))
