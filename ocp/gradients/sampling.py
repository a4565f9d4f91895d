"""Run one estimator over its samples: moments as they come, nothing kept but a bounded part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from dynamics.batch import Gaussian, Moments
from ocp.gradients.estimators import CHUNK, Estimator, Sampler
from ocp.gradients.objective import SampledObjective
from ocp.store.checkpoint import Checkpoint

_KEPT_VALUES = 1 << 20
BULK = 1 << 18
"""Samples whose moments are asked for at once; fixed for the same reason as `CHUNK`."""

CheckpointKey = tuple[Checkpoint, str]
"""Where sums under way are kept, and under which key."""
Progress = Callable[[int], None]
"""Called with the number of samples done since the last call."""


@dataclass(frozen=True)
class EstimatorRun:
    """Moments of one estimator's samples, (d,) each.

    ``first_samples`` (k, d) are kept one by one, ``largest`` is the largest norm among them, and
    ``nonfinite`` holds the indices of samples left out for a NaN or an infinity.
    """

    moments: Moments
    largest: float
    first_samples: np.ndarray
    nonfinite: np.ndarray


def run_estimator(
    objective: SampledObjective,
    estimator: Estimator,
    noise: Gaussian,
    n: int,
    progress: Progress | None = None,
    keep: CheckpointKey | None = None,
) -> EstimatorRun:
    """Sample ``n`` estimates, merging the moments of chunks in their order (Welford, Chan).

    The chunks do not depend on threads or block size, so neither does any bit of the answer. With
    ``keep`` the sums so far are saved now and then, and a later call goes on from them.
    """
    sums = _Sums(len(objective.theta))
    if keep is not None:
        sums.restore(keep)
    if progress is not None and sums.done:
        progress(sums.done)
    sampler: Sampler | None = None
    while sums.done < n:
        sampler = sampler or estimator.sampler(objective, noise, n)
        size = _advance(sums, sampler, noise, n)
        if progress is not None:
            progress(size)
        if keep is not None and (sums.done == n or keep[0].due()):
            sums.save(keep)
    return EstimatorRun(
        sums.total, sums.largest, np.concatenate(sums.kept), np.concatenate(sums.nonfinite)
    )


def _advance(sums: _Sums, sampler: Sampler, noise: Gaussian, n: int) -> int:
    """Take the next samples in: one by one while they are kept, then in bulk where that exists."""
    here, left = noise.after(sums.done), n - sums.done
    if not sums.keeps:
        size = min(BULK, left)
        found = sampler.bulk(here, size)
        if found is not None:
            sums.add_moments(*found, size)
            return size
    size = min(CHUNK, left)
    sums.add(sampler.single(here, size))
    return size


class _Sums:
    """What is kept of the samples done so far; saved and restored without losing a bit."""

    def __init__(self, d: int) -> None:
        self.done, self.largest = 0, 0.0
        self.total = Moments(0, np.zeros(d), np.zeros(d))
        self.kept = [np.empty((0, d))]
        self.nonfinite = [np.empty(0, dtype=np.int64)]

    def add(self, values: np.ndarray) -> None:
        """Take the next chunk of single estimates in, (m, d)."""
        size = len(values)
        finite = np.isfinite(values).all(axis=1)
        if not finite.all():
            self.nonfinite.append(self.done + np.flatnonzero(~finite))
            values = values[finite]
        self.total = self.total.merged(_moments(values))
        if len(values):
            self.largest = max(self.largest, float(np.square(values).sum(axis=1).max()) ** 0.5)
        if self.keeps:
            self.kept.append(values)
        self.done += size

    @property
    def keeps(self) -> bool:
        """Whether samples are still kept one by one."""
        return self.done * len(self.total.mean) < _KEPT_VALUES

    def add_moments(self, found: Moments, nonfinite: np.ndarray, size: int) -> None:
        """Take the moments of the next ``size`` samples in."""
        if len(nonfinite):
            self.nonfinite.append(self.done + nonfinite)
        self.total = self.total.merged(found)
        self.done += size

    def save(self, keep: CheckpointKey) -> None:
        """Write the sums."""
        checkpoint, key = keep
        checkpoint.save_state(
            key, done=self.done, largest=self.largest, n=self.total.n, mean=self.total.mean,
            m2=self.total.m2, kept=np.concatenate(self.kept),
            nonfinite=np.concatenate(self.nonfinite),
        )  # fmt: skip

    def restore(self, keep: CheckpointKey) -> None:
        """Go on from sums that were written, where there are any."""
        checkpoint, key = keep
        found = checkpoint.state(key)
        if found is None:
            return
        self.done, self.largest = int(found["done"]), float(found["largest"])
        self.total = Moments(int(found["n"]), found["mean"], found["m2"])
        self.kept, self.nonfinite = [found["kept"]], [found["nonfinite"]]


def _moments(values: np.ndarray) -> Moments:
    n, d = values.shape
    if n == 0:
        return Moments(0, np.zeros(d), np.zeros(d))
    mean = values.mean(axis=0)
    return Moments(n, mean, np.square(values - mean).sum(axis=0))
