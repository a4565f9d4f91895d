"""Jobs over processes: each worker does one after another, and a dead one is replaced.

A pool, of concurrent.futures or joblib, gives up all jobs where one worker is killed, cannot report
whose job it died of, and hears nothing from a job before its end.
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

from ocp.jobs.sequential import TRIES, Callback, Failure, Function, run_job, worker_died

_GRACE_S = 30.0
"""How long a worker may take to keep what it has done before it is ended."""
# A fork of a process that has threads, as numerical libraries start them, may hang.
_context = multiprocessing.get_context("spawn")
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_interrupted = threading.Event()
"""Set in a worker that got the signal of Ctrl-C."""


def run_in_processes(
    function: Function, jobs: Sequence[Any], workers: int, callback: Callback
) -> Generator[tuple[int, Any], None, None]:
    """Do the jobs in ``workers`` processes; yield place and outcome of each as they end.

    A job whose worker dies is begun again, by another worker. When the caller stops, workers get
    the signal of Ctrl-C, and some time to keep what is done.
    """
    waiting, tries = deque(range(len(jobs))), [0] * len(jobs)
    crew: list[_Worker] = []
    try:
        while waiting or crew:
            while waiting and len(crew) < workers:
                with _uninterrupted():
                    crew.append(_Worker.hired(function))
                crew[-1].give(waiting.popleft(), jobs)
            ready = wait([worker.pipe for worker in crew])
            for worker in [one for one in crew if one.pipe in ready]:
                message = worker.received()
                if message is None:
                    crew.remove(worker)
                    place = worker.dismissed()
                    tries[place] += 1
                    if tries[place] < TRIES:
                        waiting.appendleft(place)
                    else:
                        yield place, worker_died(place)
                    continue
                word, content = message
                if word == "progress":
                    callback(worker.place, content)
                    continue
                yield worker.place, content
                if waiting:
                    worker.give(waiting.popleft(), jobs)
                else:
                    crew.remove(worker)
                    worker.dismissed()
    finally:
        _stop(crew)


@dataclass
class _Worker:
    process: Any
    pipe: Any
    place: int = -1

    @classmethod
    def hired(cls, function: Function) -> _Worker:
        here, there = _context.Pipe()
        process = _context.Process(target=_serve, args=(function, there), daemon=True)
        with _alone():
            process.start()
        there.close()
        return cls(process, here)

    def give(self, place: int, jobs: Sequence[Any]) -> None:
        self.place = place
        # A worker that has died meanwhile is noticed when it is listened to.
        with suppress(OSError):
            self.pipe.send((jobs[place],))

    def received(self) -> tuple[str, Any] | None:
        """What the worker says, or None where it has died."""
        try:
            return self.pipe.recv()
        except (EOFError, OSError):
            return None

    def dismissed(self) -> int:
        """Close the pipe, at which a worker ends; gives the place of its last job."""
        self.pipe.close()
        self.process.join()
        return self.place


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Hold a Ctrl-C back to the end; a process that is started inside holds it back on its own."""
    # Python's tracker, which starts with the first process, would let signals through again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _alone() -> Iterator[None]:
    """Start processes that leave the other cores to others, and the caller's program alone.

    Workers find their function by its module. To run the main program again, as ``spawn`` does for
    what is defined there, would begin everything anew in a script without a guard, and cannot be
    where the program came from a pipe.
    """
    main, given = sys.modules["__main__"], [name for name in _THREADS if name not in os.environ]
    sys.modules["__main__"] = ModuleType("__main__")
    os.environ.update(dict.fromkeys(given, "1"))
    try:
        yield
    finally:
        sys.modules["__main__"] = main
        for name in given:
            del os.environ[name]


def _stop(crew: Sequence[_Worker]) -> None:
    for worker in crew:
        with suppress(OSError, TypeError):
            os.kill(worker.process.pid, signal.SIGINT)
            # One that does not hear signals yet, as it is starting, ends with its first job.
            worker.pipe.send(())
    end = time.monotonic() + _GRACE_S
    for worker in crew:
        # What a worker says now is not callback; a full pipe must not hold it.
        while worker.process.is_alive() and time.monotonic() < end:
            if worker.pipe.poll(0.1) and worker.received() is None:
                break
        worker.process.join(max(0.0, end - time.monotonic()))
        worker.process.kill()
        worker.dismissed()


def _serve(function: Function, pipe: Any) -> None:
    """Do jobs until the pipe closes, or Ctrl-C."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    signal.signal(signal.SIGINT, _once)

    def report(message: Any) -> None:
        _check_interrupt()
        pipe.send(("progress", message))

    with suppress(KeyboardInterrupt, EOFError, OSError):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        while given := pipe.recv():
            outcome = run_job(function, given[0], report)
            _check_interrupt()
            pipe.send(("ended", _sendable(outcome)))


def _check_interrupt() -> None:
    """A solver in compiled code makes a failed solve of Ctrl-C, which is no outcome of a job."""
    if _interrupted.is_set():
        raise KeyboardInterrupt


def _sendable(outcome: Any) -> Any:
    if isinstance(outcome, Failure):
        try:
            pickle.loads(pickle.dumps(outcome))
        except Exception:
            return Failure(RuntimeError(f"{type(outcome.error).__name__}: {outcome.error}"))
    return outcome


def _once(*_: object) -> None:
    # On a terminal Ctrl-C reaches the workers too, and then again from the parent.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _interrupted.set()
    raise KeyboardInterrupt


def _end_with_parent() -> None:
    """Nobody would hear a worker whose parent was killed."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
