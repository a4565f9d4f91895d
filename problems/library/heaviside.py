"""A step function: the simplest objective whose first-order gradient is biased."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.systems import ParameterTable
from ocp.gradients.objective import ClosedForm
from problems.parameters import Parameters, quantity
from problems.spec import Citation

name = "heaviside"
title = "A step, whose pathwise gradient is zero almost everywhere"
citation = Citation("suh2022pathologies", "Pathologies of differentiable simulators, ex. III.2")
equations = r"""
f(theta, w) = H(theta + w), quad H(t) = 1 "for" t >= 0 "else" 0, quad w tilde "N"(0, sigma^2)
F = Phi(theta \/ sigma), quad (dif F) / (dif theta) = phi(theta \/ sigma) \/ sigma
"""


class Params(Parameters):
    """Parameters of ``heaviside``; theta is the decision, without a unit."""

    theta: float = quantity(0.0, "1", "decision")
    sigma: float = quantity(0.2, "1", "standard deviation of the noise on theta", above=0)


def cost(params: Params, theta: ca.SX, p: ParameterTable) -> ca.SX:
    """Return the step function H(theta) of Suh et al. (2022), ex. III.2."""
    return theta >= 0


def closed_form(values: dict[str, float], sigma: float) -> ClosedForm:
    """Return the exact mean F and its gradient, and means and variances of the gradient's estimators.

    With ``t = theta/sigma`` and ``A = Phi(t) - t phi(t)``: ``F = Phi(t)``, ``F' = phi(t)/sigma``,
    one zeroth-order sample has the variance ``(A - phi(t)^2)/sigma^2``; a first-order sample is always
    zero. Suh et al. (2022), ex. III.2, write ``erf(-theta; sigma^2)`` for the tail Phi(t), and state that
    the mean of the Dirac impulse is zero; in fact only the mean of the pointwise derivative is zero.
    """
    from scipy.stats import norm

    theta, zero = values["theta"], np.zeros(1)
    return ClosedForm(
        objective=float(norm.cdf(theta / sigma)),
        gradient=np.array([float(norm.pdf(theta / sigma)) / sigma]),
        zobg_variance=np.array([zobg_variance(theta, sigma, 0.0)]),
        fobg_mean=zero,
        fobg_variance=zero,
    )


def zobg_variance(theta: float, sigma: float, baseline: float) -> float:
    """Return the variance of one sample of the zeroth-order gradient with a constant baseline b.

    The variance is ``((1 - 2 b) A + b^2 - phi(t)^2)/sigma^2``, minimal at b = A; see :func:`closed_form` for A, t.
    """
    from scipy.stats import norm

    t = theta / sigma
    density = float(norm.pdf(t))
    A = float(norm.cdf(t)) - t * density
    return ((1 - 2 * baseline) * A + baseline**2 - density**2) / sigma**2
