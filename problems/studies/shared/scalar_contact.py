"""One contact and nothing else: ``lam`` over the gap z, its slope and its curvature."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import quad
from scipy.optimize import minimize
from scipy.special import erf
from scipy.stats import norm, t

from dynamics.batch import BatchFunction
from dynamics.contact import Adaptive, Barrier, ContactLaw
from dynamics.systems import Parameter, ParameterTable, Signal, lcs


@dataclass(frozen=True)
class ScalarContact:
    """A law's answer over z, all (n,): ``lam``, ``mu``, and total derivatives of lam by z."""

    lam: np.ndarray
    mu: np.ndarray
    slope: np.ndarray
    curvature: np.ndarray


_BARRIER, _GAUSSIAN = Barrier(mu=1.0), Adaptive(sigma=1.0)
"""One object each, since a law is compiled once an object; their own parameters are inputs."""


def barrier_contact(z: ArrayLike, F: ArrayLike, mu: ArrayLike) -> ScalarContact:
    """:func:`scalar_contact` under the barrier law at constant ``mu`` [N s m]."""
    return scalar_contact(_BARRIER, z, F, mu=mu)


def gaussian_contact(z: ArrayLike, F: ArrayLike, sigma: ArrayLike) -> ScalarContact:
    """:func:`scalar_contact` under the adaptive law that is Gaussian smoothing by ``sigma`` [m]."""
    return scalar_contact(_GAUSSIAN, z, F, sigma=sigma)


def scalar_contact(
    law: ContactLaw, z: ArrayLike, F: ArrayLike, **law_values: ArrayLike
) -> ScalarContact:
    """Evaluate ``0 <= lam ⟂ z + F lam >= 0`` as ``law`` closes it, at gaps ``z`` (n,) [m].

    lam is an impulse [N s]; F [m/(N s)] and ``law_values`` (``mu``, ``sigma``) are numbers
    or (n,). The system is ``x+ = lam`` with the gap as its state.
    """
    solve, derive, p = _built(law)
    points, none = np.reshape(np.asarray(z, dtype=float), (-1, 1)), np.zeros(1)
    values = np.broadcast_to(p.pack({"F": F}, **law_values), (len(points), len(p)))
    _, impulse, _, _ = solve(points, none, values)
    found = derive(points, none, values, impulse)
    return ScalarContact(*(array[:, 0] for array in (impulse, *found)))


@lru_cache(maxsize=8)
def _built(law: ContactLaw) -> tuple[BatchFunction, BatchFunction, ParameterTable]:
    """Compile the step of ``law`` and its derivatives, of (z, u, p) and of (z, u, p, lam)."""
    table = ParameterTable([Parameter("F", 1.0, "m/(N s)")])
    compliance = table["F"]
    system = lcs(
        "scalar contact",
        A=[[0.0]], B=[[0.0]], C=[[1.0]], D=[[1.0]], E=[[0.0]], F=compliance,
        states=(Signal("z", "m"),), inputs=(Signal("none", "1"),),
        contacts=(Signal("contact", "N s"),), parameters=table,
    )  # fmt: skip
    step = law.close(system)
    x, u, p, lam = system.x, system.u, step.p.vector, step.lam
    slope = step.contact_jacobian(x)
    curvature = ca.jacobian(slope, x) + ca.jacobian(slope, lam) @ slope
    derive = ca.Function("scalar_contact", [x, u, p, lam], [step.mu, slope, ca.densify(curvature)])
    return BatchFunction(step.solve), BatchFunction(derive), step.p


Density = Callable[[Any], Any]
"""Probability density of the noise on the gap, over arrays of w [m]."""


def student(F: float, mu: float) -> Density:
    """Return the noise that constant mu stands for: Student's t_2 of scale sqrt(2 F mu)."""
    return lambda w: t.pdf(w, 2, 0, np.sqrt(2 * F * mu))


def gaussian(sigma: float) -> Density:
    """Return the density of N(0, sigma²)."""
    return lambda w: norm.pdf(w, 0, sigma)


def printed_kappa(z: np.ndarray, sigma: float | np.ndarray) -> np.ndarray:
    """Abs, eq. 5.1 literally, c1 = c2 = 0; it has no F, and its erf lacks a half in the exponent.

    ``z erf(z) + exp(-z²/(2 sigma))/sqrt(pi)``, erf(y) = int_y^inf exp(-s²/sigma²)/(sqrt(2 pi)
    sigma) ds.
    """
    tail = norm.sf(z * np.sqrt(2) / sigma) / np.sqrt(2)
    return z * tail + np.exp(-(z**2) / (2 * sigma)) / np.sqrt(np.pi)


def ordinary_kappa(z: np.ndarray, sigma: float | np.ndarray) -> np.ndarray:
    """Abs, eq. 5.1 with the ordinary error function for its erf, c1 = c2 = 0."""
    return z * erf(z) + np.exp(-(z**2) / (2 * sigma)) / np.sqrt(np.pi)


def misfit(printed: np.ndarray, true: np.ndarray, z: np.ndarray) -> float:
    """Largest ``|printed + c1 z + c2 - true|`` over z (n,) at the best c1, c2 in least squares."""
    rows = np.stack((z, np.ones_like(z)), axis=1)
    best = np.linalg.lstsq(rows, true - printed, rcond=None)[0]
    return float(np.abs(printed + rows @ best - true).max())


def averaged_exact(z: float, F: float, density: Density) -> float:
    """E[max(0, -(z + w))/F] by quadrature over the distribution of w."""
    return quad(lambda w: -(z + w) / F * density(w), -np.inf, -z, epsabs=1e-13)[0]


def least_residual(z: float, F: float, sigma: float) -> float:
    """``min E|S_0(z + w) - W w - K|`` over K and W for w ~ N(0, sigma²): delta of abs, prop. 5.3.

    S_0 is homogeneous, so it is sigma/F times that of z/sigma.
    """
    (K, W), _ = linearisations(z / sigma, 1.0, 1.0)
    w = np.linspace(-8, 8, 8001)
    off = np.abs(np.maximum(0, -(z / sigma + w)) - W * w - K)
    return float(np.sum(norm.pdf(w) * off) * (w[1] - w[0]) * sigma / F)


def linearisations(z: float, F: float, sigma: float) -> np.ndarray:
    """Best (K, W) of S_0(z + w) ~ W w + K for w ~ N(0, sigma²): rows for |.| and for (.)²."""
    w, weight = np.polynomial.hermite_e.hermegauss(200)
    kept = weight > 1e-16
    w, weight = sigma * w[kept], weight[kept] / weight.sum()
    target = np.maximum(0, -(z + w)) / F
    rows = np.stack((np.ones_like(w), w), 1) * np.sqrt(weight)[:, None]
    square = np.linalg.lstsq(rows, target * np.sqrt(weight), rcond=None)[0]
    fine = np.linspace(-8, 8, 8001) * sigma
    density, exact = norm.pdf(fine, 0, sigma), np.maximum(0, -(z + fine)) / F

    def residual(kw: np.ndarray) -> float:
        return float(np.sum(density * np.abs(exact - kw[1] * fine - kw[0])) * (fine[1] - fine[0]))

    options = {"xatol": 1e-9, "fatol": 1e-14, "maxiter": 4000}
    return np.stack((minimize(residual, square, method="Nelder-Mead", options=options).x, square))
