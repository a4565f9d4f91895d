"""Parallel jobs: in this process, in processes of this computer, or on a Dask cluster."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import closing
from typing import Any

from ocp.errors import InputError
from ocp.jobs.sequential import Callback, Failure, Function, Report, run_sequentially

__all__ = ["Callback", "Failure", "Function", "Report", "results_in_order", "run_jobs"]


def run_jobs(
    function: Function,
    jobs: Sequence[Any],
    workers: int = 1,
    scheduler: str | None = None,
    callback: Callback = lambda *_: None,
) -> Generator[tuple[int, Any], None, None]:
    """Run all jobs; yield the index in the list and the outcome of each as it ends.

    ``function(job, report)`` must depend on its job alone, which is plain data that can be
    pickled. Results are then the same in any process and any order, and a job whose worker died
    can be started again. An outcome is a result or a :class:`~ocp.jobs.scheduling.Failure`. What a
    job reports arrives here as ``callback(place, message)``.

    One worker is this process; more are processes of this computer. With ``scheduler``, an address
    such as ``tcp://127.0.0.1:8786``, the jobs go to a Dask cluster, whose workers see this package.

    Raises :class:`~ocp.errors.InputError` for fewer than one worker, where dask.distributed is
    not installed, where no scheduler answers, and where it has no workers.
    """
    if workers < 1:
        raise InputError(f"jobs need at least 1 worker, got {workers}")
    if scheduler is not None:
        from ocp.jobs.cluster import run_on_cluster

        return run_on_cluster(function, jobs, scheduler, callback)
    if workers == 1 or len(jobs) == 1:
        return run_sequentially(function, jobs, callback)
    from ocp.jobs.processes import run_in_processes

    return run_in_processes(function, jobs, workers, callback)


def results_in_order(
    function: Function,
    jobs: Sequence[Any],
    workers: int = 1,
    scheduler: str | None = None,
    callback: Callback = lambda *_: None,
) -> Generator[Any, None, None]:
    """Run all jobs as :func:`run_jobs` does; yield their results in the jobs' order, raise their errors."""
    finished: dict[int, Any] = {}
    next_index = 0
    with closing(run_jobs(function, jobs, workers, scheduler, callback)) as outcomes:
        for index, outcome in outcomes:
            if isinstance(outcome, Failure):
                raise outcome.error
            finished[index] = outcome
            while next_index in finished:
                yield finished.pop(next_index)
                next_index += 1
