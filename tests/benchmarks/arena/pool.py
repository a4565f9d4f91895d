"""Many answers at once: one process for each, so many beside one another, stopped together at a deadline."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Iterator
from multiprocessing import get_context
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from typing import Any

from tests.benchmarks.arena.race import send_row, unanswered

Key = tuple[str, int, str]
"""Task, instance and way of an answer."""
_THREADS = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
"""Environment of each process: one thread, since the processes share the cores."""


def rows_of(keys: Iterable[Key], jobs: int, limit: int, wall: float) -> Iterator[dict[str, Any]]:
    """Yield the rows of answers as they end, ``jobs`` at a time.

    An answer ends after ``limit`` seconds of processor time, with a row that says so. After ``wall`` seconds all end,
    and those that run have no row.
    """
    os.environ.update(_THREADS)
    context = get_context("forkserver")
    context.set_forkserver_preload(["tests.benchmarks.arena.race"])
    began, waiting = time.monotonic(), iter(keys)
    running: dict[Any, tuple[Key, BaseProcess]] = {}
    try:
        while (left := began + wall - time.monotonic()) > 0:
            while len(running) < jobs and (key := next(waiting, None)):
                receiver, sender = context.Pipe(duplex=False)
                process = context.Process(target=send_row, args=(sender, *key, limit), daemon=True)
                process.start()
                sender.close()
                running[receiver] = key, process
            if not running:
                return
            for receiver in wait(list(running), left):
                key, process = running.pop(receiver)
                try:
                    yield receiver.recv()
                except EOFError:
                    yield unanswered(*key, limit)
                process.join()
    finally:
        for _, process in running.values():
            process.terminate()
