"""Many jobs side by side: here, over processes of this computer, or over a Dask cluster."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any

from ocp.errors import InputError

Report = Callable[[Any], None]
"""What a job calls with plain data on its way: numbers, texts, lists and dictionaries of them."""
Function = Callable[[Any, Report], Any]
"""Does one job, ``function(job, report)``; a public function that workers import by name."""
Callback = Callable[[int, Any], None]
"""Called here with the place of a job in the list and what it told."""
TRIES = 3
"""How often a job is begun whose worker dies of it."""


@dataclass(frozen=True)
class Failure:
    """A job that raised ``error`` instead of giving a result."""

    error: Exception


def run_job(function: Function, job: Any, report: Report) -> Any:
    """Do a job: its result, or a :class:`Failure`."""
    try:
        return function(job, report)
    except Exception as error:
        return Failure(error)


def run_sequentially(
    function: Function, jobs: Sequence[Any], callback: Callback
) -> Generator[tuple[int, Any], None, None]:
    """Do the jobs in this process one after another; yield place and outcome of each."""
    for place, job in enumerate(jobs):

        def report(message: Any, place: int = place) -> None:
            callback(place, message)

        yield place, run_job(function, job, report)


def worker_died(place: int) -> Failure:
    """Say that a job is given up, for its worker died each time."""
    return Failure(
        RuntimeError(
            f"job {place + 1} failed: its worker died each time, killed or out of"
            " memory; use fewer processes"
        )
    )


def run_jobs(
    function: Function,
    jobs: Sequence[Any],
    workers: int = 1,
    scheduler: str | None = None,
    callback: Callback = lambda *_: None,
) -> Generator[tuple[int, Any], None, None]:
    """Do all jobs; yield the place in the list and the outcome of each as they end.

    ``function(job, report)`` must depend on its job alone, which is plain data that can be
    pickled. Results are then the same in any process and any order, and a job whose worker died
    can be started again. An outcome is a result or a :class:`~ocp.scheduling.Failure`. What a
    job reports arrives here as ``callback(place, message)``.

    One worker is this process; more are processes of this computer. With ``scheduler``, an address
    such as ``tcp://127.0.0.1:8786``, the jobs go to a Dask cluster, whose workers see this package.

    Raises :class:`~ocp.errors.InputError` for fewer than one worker, where dask.distributed is
    not installed, where no scheduler answers, and where it has no workers.
    """
    if workers < 1:
        raise InputError(f"jobs need at least 1 worker, got {workers}")
    if scheduler is not None:
        from ocp.scheduling.cluster import run_on_cluster

        return run_on_cluster(function, jobs, scheduler, callback)
    if workers == 1 or len(jobs) == 1:
        return run_sequentially(function, jobs, callback)
    from ocp.scheduling.processes import run_in_processes

    return run_in_processes(function, jobs, workers, callback)
