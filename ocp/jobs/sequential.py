"""One job: its function, its result or failure, and what it reports."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any

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
        RuntimeError(f"job {place + 1} failed: its worker died each time, killed or out of memory; use fewer processes")
    )
