"""A list of jobs, the one function that does each of them, and where they are done."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any

from ocp.errors import InputError

Tell = Callable[[Any], None]
"""What a job calls with plain data on its way: numbers, texts, lists and dictionaries of them."""
Function = Callable[[Any, Tell], Any]
"""Does one job, ``function(job, tell)``; a public function of a module, found there by workers."""
Heard = Callable[[int, Any], None]
"""Called here with the place of a job in the list and what it told."""
TRIES = 3
"""How often a job is begun whose worker dies of it."""


@dataclass(frozen=True)
class Failure:
    """A job that raised ``error`` instead of giving a result."""

    error: Exception


def attempt(function: Function, job: Any, tell: Tell) -> Any:
    """Do a job: its result, or a :class:`Failure`."""
    try:
        return function(job, tell)
    except Exception as error:
        return Failure(error)


def in_turn(
    function: Function, jobs: Sequence[Any], heard: Heard
) -> Generator[tuple[int, Any], None, None]:
    """Do the jobs in this process one after another; yield place and outcome of each."""
    for place, job in enumerate(jobs):

        def tell(message: Any, place: int = place) -> None:
            heard(place, message)

        yield place, attempt(function, job, tell)


def died(place: int) -> Failure:
    """Say that a job is given up, for its worker died each time."""
    return Failure(
        RuntimeError(
            f"job {place + 1} is given up: its worker died each time, killed or out of"
            " memory; run fewer side by side"
        )
    )


def carried_out(
    function: Function,
    jobs: Sequence[Any],
    workers: int = 1,
    scheduler: str | None = None,
    heard: Heard = lambda *_: None,
) -> Generator[tuple[int, Any], None, None]:
    """Do all jobs; yield the place in the list and the outcome of each as they end.

    ``function(job, tell)`` must depend on its job alone, plain data that can be sent: then results
    are the same wherever and in whatever order they are made, and a job whose worker died can be
    begun again. An outcome is a result or a :class:`~ocp.scheduling.jobs.Failure`. What jobs tell
    on their way is ``heard(place, message)`` in this process.

    One worker is this process; more are processes of this computer. With ``scheduler``, an address
    such as ``tcp://127.0.0.1:8786``, the jobs go to a Dask cluster, whose workers see this package.

    Raises :class:`~ocp.errors.InputError` for fewer than one worker, where dask.distributed is
    not installed, where no scheduler answers, and where it has no workers.
    """
    if workers < 1:
        raise InputError(f"jobs need at least 1 worker, got {workers}")
    if scheduler is not None:
        from ocp.scheduling.cluster import over_cluster

        return over_cluster(function, jobs, scheduler, heard)
    if workers == 1 or len(jobs) == 1:
        return in_turn(function, jobs, heard)
    from ocp.scheduling.processes import over_processes

    return over_processes(function, jobs, workers, heard)
