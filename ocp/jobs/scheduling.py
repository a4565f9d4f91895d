"""Scheduling of jobs in this process, in several processes of this computer, or on a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from dynamics.limits import WORKERS
from dynamics.settings import read_value
from ocp.jobs.sequential import Callback, Failure, Function, Report, run_sequentially

__all__ = ["Callback", "Failure", "Function", "Report", "SavedResults", "Workers", "in_order", "map_jobs", "run_jobs"]

Key = TypeVar("Key")


def run_jobs(
    function: Function,
    jobs: Sequence[Any],
    workers: int = 1,
    scheduler: str | None = None,
    callback: Callback = lambda *_: None,
) -> Generator[tuple[int, Any], None, None]:
    """Run all jobs; yield the index and the outcome of each job as it ends.

    ``function(job, report)`` must depend only on the job, which is plain data that can be pickled. Results
    are then the same in any process and order, and a job can be started again if its worker dies. An outcome is a
    result or a :class:`~ocp.jobs.scheduling.Failure`. For each report of a job, ``callback(index, message)`` is
    called in this process.

    With one worker, jobs run in this process; with several, in processes on this computer. With ``scheduler``,
    an address such as ``tcp://127.0.0.1:8786``, jobs run on a Dask cluster, whose workers must be able to
    import this package.

    Raises :class:`~ocp.errors.InputError` for fewer than one worker, and if dask.distributed is not installed,
    no scheduler answers, or the scheduler has no workers.
    """
    read_value("jobs", workers, int, **WORKERS)
    if scheduler is not None:
        from ocp.jobs.cluster import run_on_cluster

        return run_on_cluster(function, jobs, scheduler, callback)
    if workers == 1 or len(jobs) == 1:
        return run_sequentially(function, jobs, callback)
    from ocp.jobs.processes import run_in_processes

    return run_in_processes(function, jobs, workers, callback)


@dataclass(frozen=True)
class Workers:
    """Workers on which jobs run: ``jobs`` processes of this computer, or the Dask cluster at ``scheduler``."""

    jobs: int = 1
    scheduler: str | None = None

    @property
    def serial(self) -> bool:
        """Whether all jobs run in this process."""
        return self.jobs == 1 and self.scheduler is None


class SavedResults(Protocol):
    """Protocol of storage for the results of finished jobs, identified by keys."""

    def load(self, key: Any, /) -> Any:
        """Return the saved result of the job ``key``, or None if it is not finished."""
        ...

    def save(self, key: Any, result: Any, /) -> Any:
        """Save the result of a finished job; return the result that is given to the caller."""
        ...


THIS_PROCESS = Workers()
"""Workers of jobs that run one after another in this process."""


def map_jobs(
    function: Function,
    jobs: Mapping[Key, Any],
    workers: Workers = THIS_PROCESS,
    saved: SavedResults | None = None,
    callback: Callable[[Key, Any], None] = lambda *_: None,
    recover: Callable[[Key, Exception], Any] | None = None,
) -> Generator[tuple[Key, Any], None, None]:
    """Run jobs with :func:`run_jobs`; yield key and result of each job: saved results first, others as jobs end.

    Jobs with a result in ``saved`` are not run. Each new result is saved there before it is yielded. If a job
    raises, the value of ``recover(key, error)`` is yielded and not saved; without ``recover`` the error is
    raised.
    """
    loaded = {} if saved is None else {key: saved.load(key) for key in jobs}
    yield from ((key, result) for key, result in loaded.items() if result is not None)
    unfinished = [key for key in jobs if loaded.get(key) is None]
    if not unfinished:
        return
    work = [jobs[key] for key in unfinished]

    def report(index: int, message: Any) -> None:
        callback(unfinished[index], message)

    with closing(run_jobs(function, work, workers.jobs, workers.scheduler, report)) as outcomes:
        for index, outcome in outcomes:
            key = unfinished[index]
            if not isinstance(outcome, Failure):
                yield key, outcome if saved is None else saved.save(key, outcome)
            elif recover is not None:
                yield key, recover(key, outcome.error)
            else:
                raise outcome.error


def in_order(results: Iterable[tuple[int, Any]]) -> Generator[Any, None, None]:
    """Yield results in the order of their indices from 0, each as soon as all earlier ones are available."""
    early: dict[int, Any] = {}
    next_index = 0
    for index, result in results:
        early[index] = result
        while next_index in early:
            yield early.pop(next_index)
            next_index += 1
