"""One job: its function, its result or failure, and its reports."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any

from ocp.errors import interruptible

Report = Callable[[Any], None]
"""Called by a job with progress as plain data: numbers, texts, lists and dictionaries of them."""
Function = Callable[[Any, Report], Any]
"""Function ``function(job, report)`` of one job; workers import it by name, so it is public."""
Callback = Callable[[int, Any], None]
"""Called in this process with the index of a job in the list and its report."""
MAX_TRIES = 3
"""Maximum number of times that a job is started if its worker dies."""


@dataclass(frozen=True)
class Failure:
    """A job that raised ``error`` instead of giving a result."""

    error: Exception


def run_job(function: Function, job: Any, report: Report) -> Any:
    """Run a job; return its result, or a :class:`Failure`."""
    try:
        with interruptible():
            return function(job, report)
    except Exception as error:
        return Failure(error)


def run_sequentially(
    function: Function, jobs: Sequence[Any], callback: Callback
) -> Generator[tuple[int, Any], None, None]:
    """Run the jobs in this process one after another; yield index and outcome of each."""
    for place, job in enumerate(jobs):

        def report(message: Any, place: int = place) -> None:
            callback(place, message)

        yield place, run_job(function, job, report)


def worker_died(place: int) -> Failure:
    """Return the failure of a job whose worker died each time."""
    return Failure(
        RuntimeError(f"job {place + 1} failed: its worker died each time, killed or out of memory; use fewer processes")
    )
