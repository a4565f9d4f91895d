"""Run one estimator over its samples: moments as they come, nothing kept but a bounded part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynamics.batch import Gaussian, Moments
from ocp.studies.estimators import CHUNK, Estimator, shifted
from ocp.studies.objective import SampledObjective

_KEPT_VALUES = 1 << 20

Progress = Callable[[int], None]
"""Called with the number of samples done since the last call."""


@dataclass(frozen=True)
class Sampled:
    """Moments of one estimator's samples, (d,) each.

    ``largest`` is the largest norm of a single sample, ``kept`` (k, d) the first samples, and
    ``nonfinite`` the indices of samples that were left out for a NaN or an infinity.
    """

    moments: Moments
    largest: float
    kept: np.ndarray
    nonfinite: np.ndarray


def run_estimator(
    objective: SampledObjective,
    estimator: Estimator,
    noise: Gaussian,
    n: int,
    progress: Progress | None = None,
) -> Sampled:
    """Sample ``n`` estimates, merging the moments of chunks in their order (Welford, Chan).

    The chunks do not depend on threads or block size, so neither does any bit of the answer.
    """
    contributions = estimator.sampler(objective, noise, n)
    d = len(objective.theta)
    total = Moments(0, np.zeros(d), np.zeros(d))
    largest, kept, bad = 0.0, [], []
    for begin in range(0, n, CHUNK):
        size = min(CHUNK, n - begin)
        values = contributions(shifted(noise, begin), size)
        finite = np.isfinite(values).all(axis=1)
        if not finite.all():
            bad.append(begin + np.flatnonzero(~finite))
            values = values[finite]
        total = total.merged(_moments(values))
        if len(values):
            largest = max(largest, float(np.square(values).sum(axis=1).max()) ** 0.5)
        if begin * d < _KEPT_VALUES:
            kept.append(values)
        if progress is not None:
            progress(size)
    nonfinite = np.concatenate([*bad, np.empty(0, dtype=np.int64)])
    return Sampled(total, largest, np.concatenate([*kept, np.empty((0, d))]), nonfinite)


def _moments(values: np.ndarray) -> Moments:
    n, d = values.shape
    if n == 0:
        return Moments(0, np.zeros(d), np.zeros(d))
    mean = values.mean(axis=0)
    return Moments(n, mean, np.square(values - mean).sum(axis=0))
