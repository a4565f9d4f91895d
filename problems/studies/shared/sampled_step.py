"""Contact steps evaluated at many points, and solutions of a single contact as functions of its gap."""

from __future__ import annotations

from collections.abc import Callable, Mapping
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
from dynamics.contact import Adaptive, Barrier, ContactLaw, Step
from dynamics.systems import Parameter, ParameterTable, Signal, lcs


@dataclass(frozen=True)
class StepValues:
    """Values of a step at n points: ``x_next`` (n, nx), ``lam``, ``gap`` and ``mu`` (n, nlam), and derivatives.

    ``x_by_x`` (n, nx, nx), ``x_by_u`` (n, nx, nu) and ``lam_by_x`` (n, nlam, nx) are the total
    derivatives of x_next and lam through the contact.
    """

    x_next: np.ndarray
    lam: np.ndarray
    gap: np.ndarray
    mu: np.ndarray
    x_by_x: np.ndarray
    x_by_u: np.ndarray
    lam_by_x: np.ndarray


class SampledStep:
    """Step of a system under a contact law, compiled for arrays of states, inputs and parameters.

    Derivatives are :meth:`dynamics.contact.Step.contact_jacobian` at the solved impulse.
    """

    def __init__(self, step: Step) -> None:
        self._step = step
        # The path solver of several contacts has hundreds of iterations, most of them skipped by
        # CasADi's conditionals; unrolling and compiling them would take minutes.
        backend = "auto" if step.system.nlam <= 1 else "casadi"
        self._solve = BatchFunction(step.solve, backend)
        x, u, p, lam = step.system.x, step.system.u, step.p.vector, step.lam
        x_next = step.x_next_of_lam
        by_x, by_u = step.contact_jacobian(x), step.contact_jacobian(u)
        through = ca.jacobian(x_next, lam)
        outputs = [step.mu, ca.jacobian(x_next, x) + through @ by_x, ca.jacobian(x_next, u) + through @ by_u, by_x]
        dense = [ca.densify(output) for output in outputs]
        self._derive = BatchFunction(ca.Function("step_derivatives", [x, u, p, lam], dense))

    def __call__(
        self, x: ArrayLike, u: ArrayLike, values: Mapping[str, ArrayLike] | None = None, **law: ArrayLike
    ) -> StepValues:
        """Evaluate the step at ``x`` (n, nx) and ``u`` (n, nu); a single row is used for all points.

        ``values`` are parameters of the system and ``law`` those of the law: numbers, or arrays (n,)
        of one number for each point; see :meth:`dynamics.systems.ParameterTable.pack`.
        """
        system = self._step.system
        states, inputs, p = self._rows(x, u, self._step.p.pack(values, **law))
        n = len(states)
        x_next, lam, gap, _ = self._solve(states, inputs, p)
        mu, by_x, by_u, lam_by_x = self._derive(states, inputs, p, lam)

        def matrices(rows: np.ndarray, height: int, width: int) -> np.ndarray:
            return rows.reshape(n, width, height).transpose(0, 2, 1)

        return StepValues(
            x_next,
            lam,
            gap,
            mu,
            matrices(by_x, system.nx, system.nx),
            matrices(by_u, system.nx, system.nu),
            matrices(lam_by_x, self._step.n, system.nx),
        )

    def roll_out(self, x: ArrayLike, u: ArrayLike, steps: int) -> tuple[np.ndarray, np.ndarray]:
        """Return states (n, steps + 1, nx) and lam (n, steps, nlam) from ``x`` under the constant input ``u``.

        ``x`` and ``u`` have the shapes of :meth:`__call__`.
        """
        states, inputs, p = self._rows(x, u, self._step.p.values)
        n = len(states)
        path = np.empty((n, steps + 1, self._step.system.nx))
        impulses = np.empty((n, steps, self._step.n))
        path[:, 0] = states
        for k in range(steps):
            path[:, k + 1], impulses[:, k], _, _ = self._solve(path[:, k], inputs, p)
        return path, impulses

    @staticmethod
    def _rows(*arrays: ArrayLike) -> list[np.ndarray]:
        rows = [np.atleast_2d(np.asarray(array, dtype=float)) for array in arrays]
        n = max(len(array) for array in rows)
        return [np.broadcast_to(array, (n, array.shape[1])) for array in rows]


@dataclass(frozen=True)
class ScalarContact:
    """Solution of one contact at n gaps z: ``lam``, ``mu``, and first and second total derivative of lam by z, (n,)."""

    lam: np.ndarray
    mu: np.ndarray
    slope: np.ndarray
    curvature: np.ndarray


# A law is compiled once for each object; mu and sigma are inputs that every call replaces.
_BARRIER = Barrier(mu=1.0)
_GAUSSIAN = Adaptive(sigma=1.0)


def barrier_contact(z: ArrayLike, F: ArrayLike, mu: ArrayLike) -> ScalarContact:
    """Evaluate :func:`scalar_contact` under the barrier law at constant ``mu`` [N s m]."""
    return scalar_contact(_BARRIER, z, F, mu=mu)


def gaussian_contact(z: ArrayLike, F: ArrayLike, sigma: ArrayLike) -> ScalarContact:
    """Evaluate :func:`scalar_contact` under the adaptive law of Gaussian smoothing by ``sigma`` [m]."""
    return scalar_contact(_GAUSSIAN, z, F, sigma=sigma)


def scalar_contact(law: ContactLaw, z: ArrayLike, F: ArrayLike, **law_values: ArrayLike) -> ScalarContact:
    """Solve ``0 <= lam ⟂ z + F lam >= 0``, exactly or softened according to ``law``, at gaps ``z`` (n,) [m].

    lam is an impulse [N s]; F [m/(N s)] and ``law_values`` (``mu``, ``sigma``) are numbers
    or (n,). The system is ``x+ = lam`` with the gap as its state.
    """
    solve, derive, p = _built(law)
    points, none = np.reshape(np.asarray(z, dtype=float), (-1, 1)), np.zeros(1)
    values = np.broadcast_to(p.pack({"F": F}, **law_values), (len(points), len(p)))
    _, impulse, _, _ = solve(points, none, values)
    derivatives = derive(points, none, values, impulse)
    return ScalarContact(*(array[:, 0] for array in (impulse, *derivatives)))


@lru_cache(maxsize=8)
def _built(law: ContactLaw) -> tuple[BatchFunction, BatchFunction, ParameterTable]:
    """Return the step of ``law`` (a function of z, u, p), its derivatives (of z, u, p, lam), and its parameters."""
    table = ParameterTable([Parameter("F", 1.0, "m/(N s)")])
    compliance = table["F"]
    system = lcs(
        "scalar contact",
        A=[[0.0]],
        B=[[0.0]],
        C=[[1.0]],
        D=[[1.0]],
        E=[[0.0]],
        F=compliance,
        states=(Signal("z", "m"),),
        inputs=(Signal("none", "1"),),
        contacts=(Signal("contact", "N s"),),
        parameters=table,
    )
    step = law.close(system)
    x, u, p, lam = system.x, system.u, step.p.vector, step.lam
    slope = step.contact_jacobian(x)
    curvature = ca.jacobian(slope, x) + ca.jacobian(slope, lam) @ slope
    derive = ca.Function("scalar_contact", [x, u, p, lam], [step.mu, slope, ca.densify(curvature)])
    return BatchFunction(step.solve), BatchFunction(derive), step.p


Density = Callable[[Any], Any]
"""Function from noise w [m] on the gap, an array, to its probability density [1/m]."""


def student_density(F: float, mu: float) -> Density:
    """Return the noise density to which a constant mu corresponds: Student's t_2 with scale sqrt(2 F mu)."""
    return lambda w: t.pdf(w, 2, 0, np.sqrt(2 * F * mu))


def gaussian_density(sigma: float) -> Density:
    """Return the density of N(0, sigma²), the noise to which the adaptive law corresponds."""
    return lambda w: norm.pdf(w, 0, sigma)


def printed_kappa(z: np.ndarray, sigma: float | np.ndarray) -> np.ndarray:
    """Return kappa by eq. 5.1 of Zhang et al. 2023 as printed, for c1 = c2 = 0.

    ``z erf(z) + exp(-z²/(2 sigma))/sqrt(pi)``, erf(y) = int_y^inf exp(-s²/sigma²)/(sqrt(2 pi)
    sigma) ds. The printed formula lacks F, and a factor 1/2 in the exponent of erf.
    """
    tail = norm.sf(z * np.sqrt(2) / sigma) / np.sqrt(2)
    return z * tail + np.exp(-(z**2) / (2 * sigma)) / np.sqrt(np.pi)


def ordinary_kappa(z: np.ndarray, sigma: float | np.ndarray) -> np.ndarray:
    """Return kappa by eq. 5.1 of Zhang et al. 2023 with the ordinary error function as erf, c1 = c2 = 0."""
    return z * erf(z) + np.exp(-(z**2) / (2 * sigma)) / np.sqrt(np.pi)


def affine_misfit(printed: np.ndarray, true: np.ndarray, z: np.ndarray) -> float:
    """Return the largest ``|printed + c1 z + c2 - true|`` over z (n,) at the least-squares c1, c2."""
    rows = np.stack((z, np.ones_like(z)), axis=1)
    coefficients = np.linalg.lstsq(rows, true - printed, rcond=None)[0]
    return float(np.abs(printed + rows @ coefficients - true).max())


def averaged_exact(z: float, F: float, density: Density) -> float:
    """Return the mean exact impulse E[max(0, -(z + w))/F] over noise w with ``density``, by quadrature."""
    return quad(lambda w: -(z + w) / F * density(w), -np.inf, -z, epsabs=1e-13)[0]


def least_residual(z: float, F: float, sigma: float) -> float:
    """Return the minimum over K, W of ``E|S_0(z + w) - W w - K|``, w ~ N(0, sigma²); Zhang et al. 2023, prop. 5.3.

    S_0 is homogeneous, so that the minimum is sigma/F times the value at z/sigma.
    """
    (K, W), _ = best_lines(z / sigma)
    w = np.linspace(-8, 8, 8001)
    residuals = np.abs(np.maximum(0, -(z / sigma + w)) - W * w - K)
    return float(np.sum(norm.pdf(w) * residuals) * (w[1] - w[0]) * sigma / F)


def best_lines(z: float) -> np.ndarray:
    """Return (K, W) of the lines ``W w + K`` closest to S_0(z + w), w ~ N(0, 1), F = 1, in mean |.| and mean square."""
    w, weight = np.polynomial.hermite_e.hermegauss(200)
    is_weighty = weight > 1e-16
    w, weight = w[is_weighty], weight[is_weighty] / weight.sum()
    target = np.maximum(0, -(z + w))
    rows = np.stack((np.ones_like(w), w), 1) * np.sqrt(weight)[:, None]
    square = np.linalg.lstsq(rows, target * np.sqrt(weight), rcond=None)[0]
    fine = np.linspace(-8, 8, 8001)
    density, exact = norm.pdf(fine), np.maximum(0, -(z + fine))

    def residual(kw: np.ndarray) -> float:
        return float(np.sum(density * np.abs(exact - kw[1] * fine - kw[0])) * (fine[1] - fine[0]))

    options = {"xatol": 1e-9, "fatol": 1e-14, "maxiter": 4000}
    return np.stack((minimize(residual, square, method="Nelder-Mead", options=options).x, square))
