"""Sums of samples, chunk by chunk: the same to the last bit wherever a chunk is computed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dynamics.batch import Gaussian, Moments
from ocp.gradients.objective import Bulk, SampledObjective

CHUNK = 1 << 13
"""Samples that are worked on at once; fixed, since sums are taken chunk by chunk."""
BULK = 1 << 18
"""Samples whose moments are computed at once; fixed for the same reason."""

Contributions = Callable[[Gaussian, int], np.ndarray]
"""Maps (noise from its first sample on, m) to the estimates (m, d) of m single samples."""


class Sampler(NamedTuple):
    """``single`` estimates, and the moments of many at once by ``bulk``, None where it cannot."""

    single: Contributions
    bulk: Callable[[Gaussian, int], Bulk | None] = lambda noise, m: None


@dataclass(frozen=True)
class Chunk:
    """Moments (d,) of ``size`` samples without those that are ``nonfinite``, counted from 0.

    ``largest`` is the largest norm of a sample, 0 where the moments were computed in bulk.
    """

    size: int
    moments: Moments
    nonfinite: np.ndarray
    largest: float = 0.0

    @classmethod
    def of(cls, values: np.ndarray) -> Chunk:
        """Sum single estimates (m, d)."""
        finite = np.isfinite(values).all(axis=1)
        kept = values[finite]
        n, d = kept.shape
        if n == 0:
            return cls(len(values), Moments(0, np.zeros(d), np.zeros(d)), np.flatnonzero(~finite))
        mean = kept.mean(axis=0)
        moments = Moments(n, mean, np.square(kept - mean).sum(axis=0))
        largest = float(np.square(kept).sum(axis=1).max()) ** 0.5
        return cls(len(values), moments, np.flatnonzero(~finite), largest)


def chunks(sampler: Sampler, noise: Gaussian, first: int, last: int) -> Iterator[Chunk]:
    """Chunks of the samples from ``first`` to ``last``, in their order."""
    while first < last:
        here, size = noise.after(first), min(BULK, last - first)
        found = sampler.bulk(here, size)
        if found is None:
            chunk = Chunk.of(sampler.single(here, min(CHUNK, last - first)))
        else:
            chunk = Chunk(size, *found)
        yield chunk
        first += chunk.size


def costs(objective: SampledObjective) -> Sampler:
    """The costs themselves, d = 1."""
    return Sampler(
        lambda noise, m: objective.scored(noise, m).cost[:, None],
        lambda noise, m: objective.moments(noise, m, "cost"),
    )


def mean_of(parts: Iterator[Chunk]) -> float:
    """Mean of d = 1 samples, 0 where none is finite."""
    total = Moments(0, np.zeros(1), np.zeros(1))
    for part in parts:
        total = total.merged(part.moments)
    return float(total.mean[0])


def mean_cost(objective: SampledObjective, noise: Gaussian, n: int) -> float:
    """Mean of the finite costs among n samples."""
    return mean_of(chunks(costs(objective), noise, 0, n))
