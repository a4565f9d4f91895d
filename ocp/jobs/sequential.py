"""Types of jobs, their results and reports, and execution of jobs one after another in this process."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any

from ocp.errors import interruptible

Report = Callable[[Any], None]
"""Callback with a job's progress as plain data: numbers, texts, and lists or dictionaries of these."""
Function = Callable[[Any, Report], Any]
"""Function ``function(job, report)`` that runs a job; it must be public, since workers import it by name."""
Callback = Callable[[int, Any], None]
"""Callback with the index of a job and one of its reports, called in the process that started the jobs."""
MAX_TRIES = 3
"""Maximum number of times that a job is started if its worker dies each time."""


@dataclass(frozen=True)
class Failure:
    """Outcome of a job that raised ``error``."""

    error: Exception


def run_job(function: Function, job: Any, report: Report) -> Any:
    """Run a job; return its result, or a :class:`Failure` if it raised an exception."""
    try:
        with interruptible():
            return function(job, report)
    except Exception as error:
        return Failure(error)


def run_sequentially(
    function: Function, jobs: Sequence[Any], callback: Callback
) -> Generator[tuple[int, Any], None, None]:
    """Run jobs one after another in this process; yield the index and outcome of each job."""
    for index, job in enumerate(jobs):

        def report(message: Any, index: int = index) -> None:
            callback(index, message)

        yield index, run_job(function, job, report)


def worker_died(index: int) -> Failure:
    """Return the outcome of a job whose worker died at every attempt."""
    return Failure(
        RuntimeError(f"job {index + 1} failed: its worker died each time, killed or out of memory; use fewer processes")
    )
