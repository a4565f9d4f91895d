"""Many jobs side by side: here, over processes of this computer, or over a Dask cluster."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import Any

from ocp.errors import InputError
from ocp.scheduling.jobs import Failure, Function, Heard, Tell, in_turn

__all__ = ["Failure", "Function", "Heard", "Tell", "carried_out", "in_turn"]


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
