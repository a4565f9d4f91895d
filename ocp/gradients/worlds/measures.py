"""Measurements of a simulator's slope: secants, their rounding errors, slopes at nearby points, smoothed gradients."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb, factorial
from typing import Any

import numpy as np

from dynamics.batch import Gaussian
from ocp.gradients.estimators import SAMPLED
from ocp.gradients.sampling import ReferenceGradient, child_seed, run_estimator
from ocp.gradients.verdict import Jump, joint_quantile, sharpest_change_on_lines
from ocp.gradients.worlds.world import WorldObjective

AMPLITUDES = tuple(float(10.0**k) for k in np.arange(-8, -1 + 1e-9, 1 / 3))
"""Amplitudes of central differences, as shares of the parameter's size."""
NEARBY_POINTS = 16
"""Number of points around the nominal parameter at which slopes are compared."""
NEARBY_REACH = 0.01
"""Distance of the farthest nearby point, as a share of the parameter's size."""
_NOISE_SPACING = 1e-10
"""Distance between the points at which rounding errors are measured, as a share of the parameter's size."""
_NOISE_ORDERS = (4, 5, 6)
"""Orders of the difference table from which the size of rounding errors is estimated."""
_NOISE_POINTS = 9
"""Number of points at which rounding errors are measured."""
_ERROR_FACTOR = 3.0
"""Half-width of the interval of a secant, in standard deviations of its rounding error."""
RANGE_POINTS = 33
"""Number of points at which the range of an output is measured."""
CERTAINTY = 1e-4
"""Error below which a secant counts as accurate, as a share of the slope."""
FIRST_ORDER, ZEROTH_ORDER = "fobg", "zobg-antithetic"
"""Estimators of first and of zeroth order of the smoothed gradient."""


@dataclass(frozen=True)
class Secants:
    """Central differences ``(y(theta + a) - y(theta - a)) / (2 a)`` over the amplitudes a (k,).

    ``slopes`` (k,) are the differences, ``ahead`` and ``behind`` (k,) the one-sided secants, and ``errors`` (k,) bound
    their rounding error. ``noise`` is the standard deviation of the output's rounding error.
    """

    amplitudes: np.ndarray
    slopes: np.ndarray
    ahead: np.ndarray
    behind: np.ndarray
    errors: np.ndarray
    noise: float

    @property
    def sharpest(self) -> int:
        """Index of the smallest amplitude whose secant has a small rounding error and is close to its neighbour's."""
        change = np.abs(np.diff(self.slopes, prepend=self.slopes[0]))
        total = np.where(np.isfinite(self.slopes), self.errors + change, np.inf)[1:]
        return int(np.argmax(total <= np.maximum(total.min(), CERTAINTY * np.abs(self.slopes[1:])))) + 1


def measure_secants(objective: WorldObjective, size: float) -> Secants:
    """Return the secants of an output over the amplitudes ``size`` times :data:`AMPLITUDES`."""
    theta, amplitudes = float(objective.theta[0]), size * np.array(AMPLITUDES)
    points = np.concatenate([[theta], theta + amplitudes, theta - amplitudes])
    values, k = objective.values_at(points), len(amplitudes)
    # Distances as rounded in the arguments.
    above, below = points[1 : k + 1] - theta, theta - points[k + 1 :]
    ahead, behind = (values[1 : k + 1] - values[0]) / above, (values[0] - values[k + 1 :]) / below
    slopes = (values[1 : k + 1] - values[k + 1 :]) / (above + below)
    noise = rounding_noise(objective, size)
    return Secants(amplitudes, slopes, ahead, behind, _ERROR_FACTOR * noise / (np.sqrt(2) * amplitudes), noise)


def rounding_noise(objective: WorldObjective, size: float) -> float:
    """Return the standard deviation of the rounding error of the output near the nominal parameter.

    It is estimated from a table of differences of order k at closely spaced points,
    ``sigma_k^2 = (k!)^2 / (2k)! mean (Delta^k y)^2`` (More and Wild 2011, doi 10.1137/100786125); the result is
    the smallest estimate of three orders k, but at least the rounding error of the output itself.
    """
    theta = float(objective.theta[0])
    values = objective.values_at(theta + _NOISE_SPACING * size * np.arange(_NOISE_POINTS))
    scale = float(np.finfo(float).eps * np.abs(values).max())
    estimates = []
    for k in _NOISE_ORDERS:
        weights = np.array([(-1) ** i * comb(k, i) for i in range(k + 1)], dtype=float)
        differences = np.convolve(values, weights, mode="valid")
        estimates.append(np.sqrt(factorial(k) ** 2 / factorial(2 * k) * np.square(differences).mean()))
    return max(float(min(estimates)), scale)


def nearby_points(theta: float, size: float) -> np.ndarray:
    """Return the nominal parameter, and points at irrational distances from it, which avoid any grid of time steps."""
    golden = (np.sqrt(5) - 1) / 2
    offsets = 2 * (golden * np.arange(1, NEARBY_POINTS + 1) % 1) - 1
    return theta + size * NEARBY_REACH * np.concatenate([[0.0], offsets])


def measure_slopes(objective: WorldObjective, size: float) -> tuple[Secants, np.ndarray]:
    """Return the secants, and the slopes at :func:`nearby_points`: derivatives, or differences if there are none."""
    secants, points = measure_secants(objective, size), nearby_points(float(objective.theta[0]), size)
    if objective.world.differentiate is not None:
        return secants, objective.slopes_at(points)
    amplitude = float(secants.amplitudes[secants.sharpest])
    values = objective.values_at(np.concatenate([points + amplitude, points - amplitude]))
    return secants, (values[: len(points)] - values[len(points) :]) / (2 * amplitude)


def smoothed_gradient(
    objective: WorldObjective,
    estimator: str,
    sigma: float,
    reference: ReferenceGradient | None,
    n: int,
    seed: np.random.SeedSequence,
) -> dict[str, Any]:
    """Estimate a smoothed gradient with its interval, and compare it with ``reference``, as a JSON object.

    ``reliable`` is the half-width of the interval in which an unbiased estimate lies with probability 0.999. The
    estimate is NaN where a sample is not finite, since the smoothed objective then has no mean.
    """
    method = SAMPLED[estimator]
    run = run_estimator(objective, method, Gaussian(sigma, child_seed(seed, method.stream)), n)
    moments = run.moments
    row: dict[str, Any] = {
        "estimator": estimator,
        "sigma": sigma,
        "n_samples": moments.n,
        "nonfinite": len(run.nonfinite),
        "mean": np.nan,
        "standard_error": np.nan,
        "reference": None if reference is None else float(reference.gradient[0]),
        "reliable": np.nan,
    }
    # Without samples that are not finite the mean is that of another function.
    if moments.n < 2 or len(run.nonfinite):
        return row
    error, quantile = float(moments.standard_error[0]), joint_quantile(1)
    known_error = 0.0 if reference is None else float(reference.standard_error[0])
    return row | {
        "mean": float(moments.mean[0]),
        "standard_error": error,
        "reliable": quantile * float(np.hypot(error, known_error)),
    }


def own_reference(row: dict[str, Any]) -> ReferenceGradient:
    """Return a zeroth-order estimate as the reference for a simulator whose exact output is unknown."""
    gradient, error = np.array([row["mean"]]), np.array([row["standard_error"]])
    return ReferenceGradient(gradient, error, "the simulator's own rollouts", row["n_samples"])


def dominant_jump(objective: WorldObjective, size: float, share: float) -> Jump | None:
    """Return the largest jump within the largest amplitude, or None if below ``share`` times the output's range."""
    end = np.array([[size * AMPLITUDES[-1]]])
    jump = sharpest_change_on_lines(objective, -end, end)
    values = objective.costs(np.linspace(-end[0], end[0], RANGE_POINTS))
    finite = values[np.isfinite(values)]
    return jump if finite.size and jump.discontinuous and jump.size > share * np.ptp(finite) else None
