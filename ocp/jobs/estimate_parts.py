"""Parallel sampling of gradient estimates, with bitwise the same results as in one process."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from dynamics.batch import Gaussian
from ocp.gradients.case import ObjectiveCase
from ocp.gradients.chunks import BULK, Chunk
from ocp.gradients.estimators import Estimator
from ocp.gradients.objective import SampledObjective
from ocp.gradients.sampling import local_chunks
from ocp.jobs.scheduling import Workers, in_order, map_jobs

PIECE = 4 * BULK
"""Number of samples that one job draws."""


@dataclass(frozen=True)
class PieceJob:
    """Job that computes samples ``first`` to ``last - 1`` of ``n``, which are costs if ``estimator`` is None."""

    case: ObjectiveCase
    estimator: Estimator | None
    noise: Gaussian
    first: int
    last: int
    n: int


# The state is local to a thread, since Dask may run two jobs in one process, each in its own thread.
_last_objective = threading.local()


def _cached_objective(case: ObjectiveCase) -> SampledObjective:
    """Return the objective of ``case``; if this thread's last job had the same case, its objective is reused."""
    key = pickle.dumps(case)
    if getattr(_last_objective, "key", None) != key:
        _last_objective.objective, _last_objective.key = case.build().objective, key
    return _last_objective.objective


def sum_piece(job: PieceJob, report: Callable[[Any], None]) -> list[Chunk]:
    """Return the chunks of a job's samples, and report the size of each chunk."""
    summed = []
    objective = _cached_objective(job.case)
    for chunk in local_chunks(objective, job.estimator, job.noise, job.first, job.last, job.n):
        report(chunk.size)
        summed.append(chunk)
    return summed


@dataclass(frozen=True)
class JobWorkers:
    """Source of chunks (:data:`~ocp.gradients.sampling.ChunkSource`) that samples an objective in parallel."""

    case: ObjectiveCase
    workers: Workers

    def __call__(self, estimator: Estimator | None, noise: Gaussian, first: int, last: int, n: int) -> Iterator[Chunk]:
        """Yield, in order, the chunks of samples ``first`` to ``last - 1`` of n; raises the exception of a failed job.

        A sample depends only on its index, not on the worker that draws it.
        """
        pieces = [
            PieceJob(self.case, estimator, noise, begin, min(begin + PIECE, last), n)
            for begin in range(first, last, PIECE)
        ]
        with closing(map_jobs(sum_piece, dict(enumerate(pieces)), self.workers)) as sums:
            for chunks_of_piece in in_order(sums):
                yield from chunks_of_piece
