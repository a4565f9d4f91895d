"""Jobs on a Dask cluster. If a worker dies, the scheduler gives its jobs to other workers."""

from __future__ import annotations

import asyncio
import queue
import uuid
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

from ocp.errors import InputError
from ocp.jobs.sequential import Callback, Failure, Function, run_job, worker_died

CONNECT_TIMEOUT_S = 10.0
"""Maximum time [s] to wait for a scheduler's answer."""
WORKER_IMPORT = "import ocp.jobs.cluster"
"""Statement that workers must be able to execute; a job that a worker cannot unpickle would never end."""


def run_on_cluster(
    function: Function, jobs: Sequence[Any], address: str, callback: Callback
) -> Generator[tuple[int, Any], None, None]:
    """Run jobs on the workers of the scheduler at ``address``; yield index and outcome of each job as it ends.

    Raises :class:`~ocp.errors.InputError` if dask.distributed is not installed, no scheduler answers, the
    scheduler has no workers, or the workers cannot import this package.
    """
    with _connect(address) as client:
        events: queue.Queue[tuple[str, int, Any]] = queue.Queue()
        topic = f"jobs-{uuid.uuid4().hex}"
        client.subscribe_topic(topic, lambda event: events.put(("progress", *event[1])))
        futures = [
            client.submit(_run_on_worker, function, job, index, topic, key=f"{topic}-{index}", pure=False)
            for index, job in enumerate(jobs)
        ]
        for index, future in enumerate(futures):
            future.add_done_callback(lambda done, index=index: events.put(("ended", index, done)))
        n_running = len(futures)
        try:
            while n_running:
                kind, index, content = events.get()
                if kind == "progress":
                    callback(index, content)
                    continue
                n_running -= 1
                yield index, _outcome(content, index)
        finally:
            with suppress(Exception):
                client.cancel(futures)


def _outcome(future: Any, index: int) -> Any:
    from distributed import KilledWorker

    error = future.exception()
    if error is None:
        return future.result()
    return worker_died(index) if isinstance(error, KilledWorker) else Failure(error)


def _run_on_worker(function: Function, job: Any, index: int, topic: str) -> Any:
    """Run a job on a Dask worker and send its reports to ``topic``; return None if the job is cancelled."""
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()

    def report(message: Any) -> None:
        task = worker.state.tasks.get(key)
        # Dask drops a cancelled task, but does not stop its thread.
        if task is None or task.state == "cancelled":
            raise KeyboardInterrupt
        worker.log_event(topic, (index, message))

    try:
        return run_job(function, job, report)
    except KeyboardInterrupt:
        return None


async def _check_answer(address: str) -> None:
    """Connect once to check that a scheduler answers; raises the errors of ``distributed.comm.connect``."""
    from distributed.comm.core import connect
    from distributed.core import coerce_to_address
    from distributed.security import Security

    secured = Security().get_connection_args("client")
    comm = await connect(coerce_to_address(address), timeout=CONNECT_TIMEOUT_S, **secured)
    await comm.close()


@contextmanager
def _connect(address: str) -> Iterator[Any]:
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            "a Dask cluster needs dask.distributed, which is not installed here; install"
            " centralpath[cluster], or use processes with --jobs"
        ) from None
    try:
        # A Client that fails to connect leaves a thread for which its destructor waits.
        asyncio.run(_check_answer(address))
        client = Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError, TypeError, NotImplementedError) as error:
        raise InputError(
            f"no Dask scheduler answers at {address!r}: {error}; start one with dask scheduler, and"
            " give its address such as tcp://127.0.0.1:8786"
        ) from None
    with client:
        if not client.scheduler_info()["workers"]:
            raise InputError(f"the Dask scheduler at {address} has no workers; start some with dask worker {address}")
        try:
            client.run(exec, WORKER_IMPORT)
        except ImportError as error:
            raise InputError(
                f"the workers of the Dask cluster at {address} lack this program: {error}; install"
                " the same centralpath for them"
            ) from None
        yield client
