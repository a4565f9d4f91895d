"""The gradient that estimates are held against: closed form, quadrature, or a larger run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynamics.batch import Gaussian
from ocp.errors import InputError
from ocp.gradients.estimators import SAMPLED
from ocp.gradients.objective import SampledObjective, StaticObjective
from ocp.gradients.sampling import CheckpointKey, Progress, run_estimator

REFERENCE_STREAM = 3
KINDS = ("auto", "closed-form", "quadrature", "zobg", "none")
_POINTS, _REACH = 1 << 21, 9.0


@dataclass(frozen=True)
class ReferenceGradient:
    """The gradient of the smoothed objective, (d,), its standard error, and where it is from.

    The error is 0 for a closed form, the numerical error of a quadrature, and the standard
    deviation of the mean for a run; ``n_samples`` is the run's size.
    """

    gradient: np.ndarray
    standard_error: np.ndarray
    source: str
    n_samples: int = 0


def reference_gradient(
    objective: SampledObjective,
    sigma: float,
    seed: np.random.SeedSequence,
    n_samples: int,
    kind: str = "auto",
    progress: Progress | None = None,
    keep: CheckpointKey | None = None,
) -> ReferenceGradient | None:
    """Find the gradient: ``auto`` takes the first that there is of the kinds in their order.

    ``zobg`` samples antithetic ZoBG pairs, ``n_samples`` of them, on a stream of its own.

    Raises :class:`~ocp.errors.InputError` where the asked one cannot be.
    """
    taken = reference_kind(objective, sigma, kind)
    if taken == "none":
        return None
    closed = objective.closed_form(sigma) if taken == "closed-form" else None
    if closed is not None:
        return ReferenceGradient(closed.gradient, np.zeros_like(closed.gradient), "closed form")
    if taken == "quadrature":
        return quadrature(objective, sigma)
    noise = Gaussian(sigma, stream(seed, REFERENCE_STREAM))
    pairs = SAMPLED["zobg-antithetic"]
    found = run_estimator(objective, pairs, noise, n_samples, progress, keep).moments
    return ReferenceGradient(found.mean, found.standard_error, "larger zobg run", found.n)


def reference_kind(objective: SampledObjective, sigma: float, kind: str) -> str:
    """Return ``kind``, for ``auto`` the one that is taken; ``zobg`` alone is sampled.

    Raises :class:`~ocp.errors.InputError` where the objective has no such reference.
    """
    closed = objective.closed_form(sigma) is not None
    line = isinstance(objective, StaticObjective) and objective.n_noise == 1
    if kind == "auto":
        return "closed-form" if closed else "quadrature" if line else "zobg"
    if kind == "closed-form" and not closed:
        raise InputError(f"{objective.name} has no closed form; say --reference zobg")
    if kind == "quadrature" and not line:
        raise InputError(
            f"{objective.name} has {objective.n_noise} noise components; quadrature needs one,"
            " added to the decision; say --reference zobg"
        )
    return kind


def stream(seed: np.random.SeedSequence, number: int) -> np.random.SeedSequence:
    """Seed of one of the independent streams that belong to ``seed``."""
    return np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, number))


def quadrature(objective: SampledObjective, sigma: float) -> ReferenceGradient:
    """``grad F = E[f(theta + w) w]/sigma^2`` by the midpoint rule over 9 sigma either side.

    The error told is the larger of the difference to the rule of half as many points and of what
    the sharpest jump can do, an interval times its height.

    Raises :class:`~ocp.errors.InputError` unless the decision is one number with noise added to it.
    """
    reference_kind(objective, sigma, "quadrature")

    def rule(points: int) -> tuple[float, float]:
        t = _REACH * (2 * (np.arange(points) + 0.5) / points - 1)
        density = np.exp(-(t**2) / 2) / np.sqrt(2 * np.pi)
        values = objective.costs((sigma * t)[:, None]) - objective.nominal()
        parts = values * t * density * (2 * _REACH / points) / sigma
        return float(parts.sum()), float(np.abs(np.diff(parts)).max())

    (fine, sharpest), (coarse, _) = rule(_POINTS), rule(_POINTS // 2)
    error = max(abs(fine - coarse), sharpest)
    return ReferenceGradient(np.array([fine]), np.array([error]), "quadrature")
