"""Samples over processes or a Dask cluster, as pieces of chunks, with the same bits."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from dynamics.batch import Gaussian
from ocp.gradients.case import ObjectiveCase
from ocp.gradients.chunks import BULK, Chunk, chunks, costs
from ocp.gradients.estimators import Estimator
from ocp.gradients.objective import SampledObjective
from ocp.jobs.scheduling import Failure, run_jobs

PIECE = 4 * BULK
"""Samples of one job."""


@dataclass(frozen=True)
class PieceJob:
    """Samples ``first`` to ``last`` of ``n``; of the costs where there is no estimator."""

    case: ObjectiveCase
    estimator: Estimator | None
    noise: Gaussian
    first: int
    last: int
    n: int


# Dask may do two jobs in one process, in a thread each.
_of_thread = threading.local()


def _kept_objective(case: ObjectiveCase) -> SampledObjective:
    """The objective of the last job of this thread, or a new one."""
    key = pickle.dumps(case)
    if getattr(_of_thread, "key", None) != key:
        _of_thread.objective, _of_thread.key = case.build().objective, key
    return _of_thread.objective


def sum_piece(job: PieceJob, report: Callable[[Any], None]) -> list[Chunk]:
    """Sum the chunks of a piece; a :data:`~ocp.jobs.scheduling.Function`."""
    objective = _kept_objective(job.case)
    sampler = costs(objective)
    if job.estimator is not None:
        sampler = job.estimator.sampler(objective, job.noise, job.n)
    found = []
    for chunk in chunks(sampler, job.noise, job.first, job.last):
        report(chunk.size)
        found.append(chunk)
    return found


@dataclass(frozen=True)
class JobWorkers:
    """Computes chunks in ``jobs`` processes, or on the cluster of ``scheduler``."""

    case: ObjectiveCase
    jobs: int = 1
    scheduler: str | None = None

    def chunks(self, estimator: Estimator | None, noise: Gaussian, first: int, last: int, n: int) -> Iterator[Chunk]:
        """Chunks of n samples from ``first`` to ``last`` in their order; raises what a job raised.

        A sample depends on its number alone, not on the worker that draws it.
        """
        pieces = [
            PieceJob(self.case, estimator, noise, begin, min(begin + PIECE, last), n)
            for begin in range(first, last, PIECE)
        ]
        ended: dict[int, list[Chunk]] = {}
        due = 0
        with closing(run_jobs(sum_piece, pieces, self.jobs, self.scheduler)) as outcomes:
            for place, outcome in outcomes:
                if isinstance(outcome, Failure):
                    raise outcome.error
                ended[place] = outcome
                while due in ended:
                    yield from ended.pop(due)
                    due += 1
