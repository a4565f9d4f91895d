"""One estimator run over its samples, moments as they come; the gradient it is held against."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dynamics.batch import Gaussian, Moments
from ocp.errors import InputError
from ocp.gradients.chunks import CHUNK, Chunk, chunks, mean_cost, mean_of
from ocp.gradients.estimators import SAMPLED, Estimator
from ocp.gradients.objective import SampledObjective, StaticObjective
from ocp.store.checkpoint import Checkpoint

_KEPT_VALUES = 1 << 20

CheckpointKey = tuple[Checkpoint, str]
"""Where sums under way are kept, and under which key."""
Progress = Callable[[int], None]
"""Called with the number of samples done since the last call."""


class Workers(Protocol):
    """What computes chunks elsewhere."""

    def chunks(self, estimator: Estimator | None, noise: Gaussian, first: int, last: int, n: int) -> Iterator[Chunk]:
        """Chunks of n samples from ``first`` to ``last``; of the costs without an estimator."""
        ...


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
    workers: Workers | None = None,
) -> EstimatorRun:
    """Sample ``n`` estimates, merging the moments of chunks in their order (Welford, Chan).

    The chunks do not depend on threads, block size or ``workers``, so neither does any bit of the
    answer. With ``keep`` the sums so far are saved now and then, and a later call resumes.
    """
    sums = _Sums(len(objective.theta))
    if keep is not None:
        sums.restore(keep)
    if progress is not None and sums.done:
        progress(sums.done)
    if sums.done < n:
        for size in _advance(sums, objective, estimator, noise, n, workers):
            if progress is not None:
                progress(size)
            if keep is not None and (sums.done == n or keep[0].due()):
                sums.save(keep)
    return EstimatorRun(sums.total, sums.largest, np.concatenate(sums.kept), np.concatenate(sums.nonfinite))


def _advance(
    sums: _Sums,
    objective: SampledObjective,
    estimator: Estimator,
    noise: Gaussian,
    n: int,
    workers: Workers | None,
) -> Iterator[int]:
    """Take all samples in and yield their numbers: one by one while they are kept, then chunks."""

    def of_all() -> float:
        if workers is None:
            return mean_cost(objective, noise, n)
        return mean_of(workers.chunks(None, noise, 0, n, n))

    estimator = estimator.with_baseline(objective, of_all)
    sampler = estimator.sampler(objective, noise, n)
    while sums.keeps and sums.done < n:
        yield sums.keep(sampler.single(noise.after(sums.done), min(CHUNK, n - sums.done)))
    if workers is None:
        left = chunks(sampler, noise, sums.done, n)
    else:
        left = workers.chunks(estimator, noise, sums.done, n, n)
    for chunk in left:
        sums.add(chunk)
        yield chunk.size


class _Sums:
    """What is kept of the samples done so far; saved and restored without losing a bit."""

    def __init__(self, d: int) -> None:
        self.done, self.largest = 0, 0.0
        self.total = Moments(0, np.zeros(d), np.zeros(d))
        self.kept = [np.empty((0, d))]
        self.nonfinite = [np.empty(0, dtype=np.int64)]

    def keep(self, values: np.ndarray) -> int:
        """Take the next single estimates (m, d) in, and keep them; return m."""
        self.kept.append(values[np.isfinite(values).all(axis=1)])
        self.add(Chunk.of(values))
        return len(values)

    @property
    def keeps(self) -> bool:
        """Whether samples are still kept one by one."""
        return self.done * len(self.total.mean) < _KEPT_VALUES

    def add(self, chunk: Chunk) -> None:
        """Take the next chunk in."""
        if len(chunk.nonfinite):
            self.nonfinite.append(self.done + chunk.nonfinite)
        self.total = self.total.merged(chunk.moments)
        self.largest = max(self.largest, chunk.largest)
        self.done += chunk.size

    def save(self, keep: CheckpointKey) -> None:
        """Write the sums."""
        checkpoint, key = keep
        checkpoint.save_state(
            key,
            done=self.done,
            largest=self.largest,
            n=self.total.n,
            mean=self.total.mean,
            m2=self.total.m2,
            kept=np.concatenate(self.kept),
            nonfinite=np.concatenate(self.nonfinite),
        )

    def restore(self, keep: CheckpointKey) -> None:
        """Go on from sums that were written, where there are any."""
        checkpoint, key = keep
        found = checkpoint.state(key)
        if found is None:
            return
        self.done, self.largest = int(found["done"]), float(found["largest"])
        self.total = Moments(int(found["n"]), found["mean"], found["m2"])
        self.kept, self.nonfinite = [found["kept"]], [found["nonfinite"]]


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
    workers: Workers | None = None,
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
    found = run_estimator(objective, pairs, noise, n_samples, progress, keep, workers).moments
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
        raise InputError(f"{objective.name} has no closed form; use --reference zobg")
    if kind == "quadrature" and not line:
        raise InputError(
            f"{objective.name} has {objective.n_noise} noise components; quadrature needs one,"
            " added to the decision; use --reference zobg"
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
