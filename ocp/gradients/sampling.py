"""Sampling of a gradient estimator in chunks, and reference gradients with which estimates are compared."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from dynamics.batch import Gaussian, Moments
from ocp.errors import InputError
from ocp.gradients.chunks import CHUNK, Chunk, cost_sampler, iterate_chunks, mean_of_chunks
from ocp.gradients.estimators import SAMPLED, Estimator
from ocp.gradients.objective import SampledObjective
from ocp.store.checkpoint import UNSAVED, SavedWork

_MAX_STORED_VALUES = 1 << 20
"""Number of values (samples times components) above which only moments are stored, not single samples."""
CheckpointKey = tuple[SavedWork, str]
"""Storage of unfinished sums, and the key under which they are saved."""
NOT_SAVED: CheckpointKey = (UNSAVED, "")
"""Checkpoint key for sums that are not saved."""
Progress = Callable[[int], None]
"""Callback with the number of samples computed since the last call."""


ChunkSource = Callable[[Estimator | None, Gaussian, int, int, int], Iterator[Chunk]]
"""Function ``(estimator, noise, first, last, n)`` that yields, in order, chunks of the samples ``first`` to ``last
- 1`` of n. If the estimator is None, the samples are costs."""


def local_chunks(
    objective: SampledObjective, estimator: Estimator | None, noise: Gaussian, first: int, last: int, n: int
) -> Iterator[Chunk]:
    """Compute chunks in this process (a :data:`ChunkSource` if the first argument is bound)."""
    sampler = cost_sampler(objective) if estimator is None else estimator.make_sampler(objective, noise, n)
    return iterate_chunks(sampler, noise, first, last)


@dataclass(frozen=True)
class EstimatorRun:
    """Result of sampling one estimator: moments (d,) of its samples, and some single samples.

    ``first_samples`` (k, d) are the first finite samples, ``largest`` is the largest norm of a sample,
    and ``nonfinite`` are the indices of samples left out because of a NaN or an infinity.
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
    checkpoint: CheckpointKey = NOT_SAVED,
    workers: ChunkSource | None = None,
) -> EstimatorRun:
    """Draw ``n`` samples of an estimator, and merge the moments of chunks in order (formulas of Welford and Chan).

    Chunks do not depend on threads, block size or ``workers``, so the result is bitwise reproducible.
    With ``checkpoint`` the sums are saved at intervals, and a later call resumes from them.
    """
    sums = _Sums(len(objective.theta))
    sums.restore(*checkpoint)
    if progress is not None and sums.done:
        progress(sums.done)
    if sums.done < n:
        for n_new in _advance(sums, objective, estimator, noise, n, workers):
            if progress is not None:
                progress(n_new)
            if sums.done == n or checkpoint[0].due():
                sums.save(*checkpoint)
    return EstimatorRun(sums.total, sums.largest, np.concatenate(sums.single_samples), np.concatenate(sums.nonfinite))


def _advance(
    sums: _Sums,
    objective: SampledObjective,
    estimator: Estimator,
    noise: Gaussian,
    n: int,
    workers: ChunkSource | None,
) -> Iterator[int]:
    """Add the remaining samples to ``sums``, first singly, then as chunk moments; yield the size of each batch."""

    chunks = workers or partial(local_chunks, objective)
    estimator = estimator.with_baseline(objective, lambda: mean_of_chunks(chunks(None, noise, 0, n, n)))
    sampler = estimator.make_sampler(objective, noise, n)
    while sums.stores_samples and sums.done < n:
        yield sums.add_singly(sampler.single(noise.skip_samples(sums.done), min(CHUNK, n - sums.done)))
    for chunk in chunks(estimator, noise, sums.done, n, n):
        sums.add(chunk)
        yield chunk.size


class _Sums:
    """Sums over the samples so far, which can be saved and restored exactly."""

    def __init__(self, d: int) -> None:
        self.done, self.largest = 0, 0.0
        self.total = Moments(0, np.zeros(d), np.zeros(d))
        self.single_samples = [np.empty((0, d))]
        self.nonfinite = [np.empty(0, dtype=np.int64)]

    def add_singly(self, values: np.ndarray) -> int:
        """Add the next m samples (m, d), and store each finite sample; return m."""
        self.single_samples.append(values[np.isfinite(values).all(axis=1)])
        self.add(Chunk.of(values))
        return len(values)

    @property
    def stores_samples(self) -> bool:
        """Whether further samples are stored, not only their moments."""
        return self.done * len(self.total.mean) < _MAX_STORED_VALUES

    def add(self, chunk: Chunk) -> None:
        """Merge the moments of the next chunk of samples."""
        if len(chunk.nonfinite):
            self.nonfinite.append(self.done + chunk.nonfinite)
        self.total = self.total.merge_with(chunk.moments)
        self.largest = max(self.largest, chunk.largest)
        self.done += chunk.size

    def save(self, files: SavedWork, key: str) -> None:
        """Save the sums to ``files`` under ``key``."""
        files.save_state(
            key,
            done=self.done,
            largest=self.largest,
            n=self.total.n,
            mean=self.total.mean,
            m2=self.total.m2,
            single_samples=np.concatenate(self.single_samples),
            nonfinite=np.concatenate(self.nonfinite),
        )

    def restore(self, files: SavedWork, key: str) -> None:
        """Load the sums saved under ``key``, if there are any."""
        state = files.state(key)
        if state is None:
            return
        self.done, self.largest = int(state["done"]), float(state["largest"])
        self.total = Moments(int(state["n"]), state["mean"], state["m2"])
        self.single_samples, self.nonfinite = [state["single_samples"]], [state["nonfinite"]]


REFERENCE_STREAM = 3
"""Index of the random stream from which a sampled reference is drawn."""
REFERENCE_KINDS = ("auto", "closed-form", "quadrature", "zobg", "none")
"""Kinds of reference gradients; ``auto`` stands for the first of the other kinds that the objective has."""
_QUADRATURE_POINTS = 1 << 21
"""Number of points of the midpoint rule for a reference by quadrature."""
_QUADRATURE_REACH = 9.0
"""Half-width of the interval of the midpoint rule, in standard deviations of the noise."""


@dataclass(frozen=True)
class ReferenceGradient:
    """Reference gradient (d,) of a smoothed objective, its standard error (d,), and a text on its source.

    ``standard_error`` is 0 for a closed form, the numerical error for a quadrature, and the standard deviation
    of the mean for a sampled reference of ``n_samples`` samples.
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
    checkpoint: CheckpointKey = NOT_SAVED,
    workers: ChunkSource | None = None,
) -> ReferenceGradient | None:
    """Return a reference gradient of the smoothed objective, or None for the kind ``none``.

    ``auto`` selects the first kind that the objective has. ``zobg`` is the mean of ``n_samples`` antithetic
    ZoBG pairs from a separate random stream.

    Raises :class:`~ocp.errors.InputError` if the objective has no reference of that ``kind``.
    """
    chosen_kind = reference_kind(objective, sigma, kind)
    if chosen_kind == "none":
        return None
    closed = objective.closed_form(sigma) if chosen_kind == "closed-form" else None
    if closed is not None:
        return ReferenceGradient(closed.gradient, np.zeros_like(closed.gradient), "closed form")
    if chosen_kind == "quadrature":
        return quadrature(objective, sigma)
    noise = Gaussian(sigma, child_seed(seed, REFERENCE_STREAM))
    pairs = SAMPLED["zobg-antithetic"]
    moments = run_estimator(objective, pairs, noise, n_samples, progress, checkpoint, workers).moments
    return ReferenceGradient(moments.mean, moments.standard_error, "larger zobg run", moments.n)


def reference_kind(objective: SampledObjective, sigma: float, kind: str) -> str:
    """Return the kind of reference, with ``auto`` replaced by the first kind that the objective has.

    Raises :class:`~ocp.errors.InputError` if the objective has no reference of that ``kind``.
    """
    closed = objective.closed_form(sigma) is not None
    line = objective.adds_noise_to_decision and objective.n_noise == 1
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


def child_seed(seed: np.random.SeedSequence, number: int) -> np.random.SeedSequence:
    """Return the seed of the independent random stream with index ``number`` derived from ``seed``."""
    return np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, number))


def quadrature(objective: SampledObjective, sigma: float, points: int = _QUADRATURE_POINTS) -> ReferenceGradient:
    """Return ``grad F = E[f(theta + w) w]/sigma^2`` by the midpoint rule with ``points`` from -9 to 9 sigma.

    Its error is the larger of two estimates: the difference from the rule with half as many points, and the
    largest difference between neighbouring terms of the sum, which bounds the effect of a jump.

    Raises :class:`~ocp.errors.InputError` unless the objective has no dynamics and its decision is a single number.
    """
    reference_kind(objective, sigma, "quadrature")

    def rule(n: int) -> tuple[float, float]:
        t = _QUADRATURE_REACH * (2 * (np.arange(n) + 0.5) / n - 1)
        density = np.exp(-(t**2) / 2) / np.sqrt(2 * np.pi)
        values = objective.costs((sigma * t)[:, None]) - objective.nominal_cost()
        terms = values * t * density * (2 * _QUADRATURE_REACH / n) / sigma
        return float(terms.sum()), float(np.abs(np.diff(terms)).max())

    (fine, rule_error), (coarse, _) = rule(points), rule(points // 2)
    error = max(abs(fine - coarse), rule_error)
    return ReferenceGradient(np.array([fine]), np.array([error]), "quadrature")
