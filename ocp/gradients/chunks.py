"""Moments of samples in chunks; the moments of a chunk are bitwise the same in every process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dynamics.batch import Gaussian, Moments
from ocp.gradients.objective import Bulk, SampledObjective

CHUNK = 1 << 13
"""Number of samples per chunk, which is fixed so that sums are bitwise reproducible."""
BULK = 1 << 18
"""Number of samples per chunk for moments computed in bulk, fixed so that sums are bitwise reproducible."""

Contributions = Callable[[Gaussian, int], np.ndarray]
"""Function from (noise, m) to estimates (m, d) from the first m samples of the noise."""


class Sampler(NamedTuple):
    """Sampler of an estimator: ``single`` returns samples, ``bulk`` moments of many samples, or None if unsupported."""

    single: Contributions
    bulk: Callable[[Gaussian, int], Bulk | None] = lambda noise, m: None


@dataclass(frozen=True)
class Chunk:
    """Moments (d,) of the finite samples in a chunk of ``size`` samples.

    ``nonfinite`` are the indices of the non-finite samples within the chunk, from 0; ``largest`` is the
    largest norm of a sample, or 0 if moments were computed in bulk.
    """

    size: int
    moments: Moments
    nonfinite: np.ndarray
    largest: float = 0.0

    @classmethod
    def of(cls, values: np.ndarray) -> Chunk:
        """Build a chunk from single samples (m, d)."""
        finite = np.isfinite(values).all(axis=1)
        finite_values = values[finite]
        n, d = finite_values.shape
        if n == 0:
            return cls(len(values), Moments(0, np.zeros(d), np.zeros(d)), np.flatnonzero(~finite))
        mean = finite_values.mean(axis=0)
        moments = Moments(n, mean, np.square(finite_values - mean).sum(axis=0))
        largest = float(np.square(finite_values).sum(axis=1).max()) ** 0.5
        return cls(len(values), moments, np.flatnonzero(~finite), largest)


def iterate_chunks(sampler: Sampler, noise: Gaussian, first: int, last: int) -> Iterator[Chunk]:
    """Compute the samples ``first`` to ``last - 1`` of the noise, and yield their chunks in order."""
    while first < last:
        remaining_noise, size = noise.skip_samples(first), min(BULK, last - first)
        if bulk_sums := sampler.bulk(remaining_noise, size):
            chunk = Chunk(size, *bulk_sums)
        else:
            chunk = Chunk.of(sampler.single(remaining_noise, min(CHUNK, last - first)))
        yield chunk
        first += chunk.size


def cost_sampler(objective: SampledObjective) -> Sampler:
    """Return a sampler of an objective's costs, as samples with one component (d = 1)."""
    return Sampler(
        lambda noise, m: objective.sample_scores(noise, m).cost[:, None],
        lambda noise, m: objective.moments(noise, m, "cost"),
    )


def mean_of_chunks(chunks_of_costs: Iterator[Chunk]) -> float:
    """Return the mean over chunks of samples with d = 1, or 0 if no sample is finite."""
    total = Moments(0, np.zeros(1), np.zeros(1))
    for chunk in chunks_of_costs:
        total = total.merge_with(chunk.moments)
    return float(total.mean[0])


def mean_cost(objective: SampledObjective, noise: Gaussian, n: int) -> float:
    """Return the mean of the finite costs among n samples of an objective."""
    return mean_of_chunks(iterate_chunks(cost_sampler(objective), noise, 0, n))
