"""Jobs in worker processes, each of which runs one job after another and is replaced if it dies.

The pools of concurrent.futures and joblib are not used: with these, all jobs fail if one worker is killed, the job
in which it died is not known, and jobs cannot report progress.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import wait
from types import ModuleType
from typing import Any

from ocp.jobs.sequential import MAX_TRIES, Callback, Failure, Function, run_job, worker_died

STOP_GRACE_S = 30.0
"""Time [s] that a stopped worker has to save its work before it is killed."""
# Processes are spawned, since a fork of a process with threads, as of numerical libraries, may hang.
_spawn_context = multiprocessing.get_context("spawn")
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""Names of environment variables that limit the threads of numerical libraries."""
_interrupted = threading.Event()
"""Event that is set in a worker process when it receives SIGINT (Ctrl-C)."""


def run_in_processes(
    function: Function, jobs: Sequence[Any], workers: int, callback: Callback
) -> Generator[tuple[int, Any], None, None]:
    """Run jobs in ``workers`` processes; yield index and outcome of each job as it ends.

    A job whose worker dies is started again in another worker. When the caller stops iterating, workers receive
    SIGINT (Ctrl-C) and have some time to save their work.
    """
    waiting, attempts = deque(range(len(jobs))), [0] * len(jobs)
    pool: list[_Worker] = []
    try:
        while waiting or pool:
            while waiting and len(pool) < workers:
                with _block_interrupts():
                    pool.append(_Worker.start(function))
                pool[-1].give(waiting.popleft(), jobs)
            readable = wait([worker.pipe for worker in pool])
            for worker in [worker for worker in pool if worker.pipe in readable]:
                message = worker.receive()
                if message is None:
                    pool.remove(worker)
                    index = worker.stop()
                    attempts[index] += 1
                    if attempts[index] < MAX_TRIES:
                        waiting.appendleft(index)
                    else:
                        yield index, worker_died(index)
                    continue
                kind, content = message
                if kind == "progress":
                    callback(worker.index, content)
                    continue
                yield worker.index, content
                if waiting:
                    worker.give(waiting.popleft(), jobs)
                else:
                    pool.remove(worker)
                    worker.stop()
    finally:
        _stop_workers(pool)


@dataclass
class _Worker:
    process: Any
    pipe: Any
    index: int = -1

    @classmethod
    def start(cls, function: Function) -> _Worker:
        parent_end, worker_end = _spawn_context.Pipe()
        process = _spawn_context.Process(target=_serve, args=(function, worker_end), daemon=True)
        with _isolated_start():
            process.start()
        worker_end.close()
        return cls(process, parent_end)

    def give(self, index: int, jobs: Sequence[Any]) -> None:
        self.index = index
        # The death of a worker is noticed at the next receive.
        with suppress(OSError):
            self.pipe.send((jobs[index],))

    def receive(self) -> tuple[str, Any] | None:
        """Return the worker's next message as (kind, content), or None if the worker has died."""
        try:
            return self.pipe.recv()
        except (EOFError, OSError):
            return None

    def stop(self) -> int:
        """Close the pipe, which ends the worker; return the index of its last job."""
        self.pipe.close()
        self.process.join()
        return self.index


@contextmanager
def _block_interrupts() -> Iterator[None]:
    """Block SIGINT (Ctrl-C) within a context, also in processes that are started within the context."""
    # Python's resource tracker, which starts with the first process, would unblock signals.
    resource_tracker.ensure_running()
    previous_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous_mask)


@contextmanager
def _isolated_start() -> Iterator[None]:
    """Context in which processes start with one thread each and do not run the caller's main program.

    Workers import their function from its module. By default ``spawn`` runs the main program again, which would
    restart a script without a ``__main__`` guard, and is impossible for a program read from a pipe.
    """
    main, unset = sys.modules["__main__"], [name for name in THREAD_VARIABLES if name not in os.environ]
    sys.modules["__main__"] = ModuleType("__main__")
    os.environ.update(dict.fromkeys(unset, "1"))
    try:
        yield
    finally:
        sys.modules["__main__"] = main
        for name in unset:
            del os.environ[name]


def _stop_workers(pool: Sequence[_Worker]) -> None:
    for worker in pool:
        with suppress(OSError, TypeError):
            os.kill(worker.process.pid, signal.SIGINT)
            # A worker that is still starting ignores signals; the empty job ends it.
            worker.pipe.send(())
    end = time.monotonic() + STOP_GRACE_S
    for worker in pool:
        # Reports are read and dropped, so that a full pipe does not block the worker.
        while worker.process.is_alive() and time.monotonic() < end:
            if worker.pipe.poll(0.1) and worker.receive() is None:
                break
        worker.process.join(max(0.0, end - time.monotonic()))
        worker.process.kill()
        worker.stop()


def _serve(function: Function, pipe: Any) -> None:
    """Run jobs from the pipe, in a worker process, until the pipe is closed or SIGINT is received."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    signal.signal(signal.SIGINT, _interrupt_once)

    def report(message: Any) -> None:
        _check_interrupt()
        pipe.send(("progress", message))

    with suppress(KeyboardInterrupt, EOFError, OSError):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        while message := pipe.recv():
            outcome = run_job(function, message[0], report)
            _check_interrupt()
            pipe.send(("ended", _sendable(outcome)))


def _check_interrupt() -> None:
    """Raise KeyboardInterrupt if SIGINT was received; compiled solvers turn the signal into a failed solve."""
    if _interrupted.is_set():
        raise KeyboardInterrupt


def _sendable(outcome: Any) -> Any:
    if isinstance(outcome, Failure):
        try:
            pickle.loads(pickle.dumps(outcome))
        except Exception:
            return Failure(RuntimeError(f"{type(outcome.error).__name__}: {outcome.error}"))
    return outcome


def _interrupt_once(*_: object) -> None:
    # On a terminal, Ctrl-C reaches workers directly, and a second time from the parent.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _interrupted.set()
    raise KeyboardInterrupt


def _end_with_parent() -> None:
    """Wait until the parent process ends, then end this worker."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
