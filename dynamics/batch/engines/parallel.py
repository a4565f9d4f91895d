"""Threads that work on chunks of samples, and their work arrays. Kernels run without the interpreter lock."""

from __future__ import annotations

import ctypes
import itertools
import math
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, TypeVar

import numpy as np

from dynamics.settings import read_count

ResultT = TypeVar("ResultT")
_pool: ThreadPoolExecutor | None = None


def available_threads() -> int:
    """Return the number of CPUs that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def checked_threads(threads: int | None) -> int:
    """Return `threads`, or the number of available CPUs for None; raise `ValueError` if it is below one."""
    return available_threads() if threads is None else read_count("threads", threads)


def over_chunks(n: int, chunk: int, threads: int, work: Callable[[int, int], None]) -> None:
    """Call `work(begin, end)` for consecutive chunks of `range(n)` on up to `threads` threads.

    Each thread takes the next chunk when it has finished one. The chunks depend on `n` and `chunk` alone, so that
    results do not depend on `threads`. The first exception is raised.
    """
    starts = range(0, n, chunk)
    tickets = itertools.count()

    def worker() -> None:
        while (ticket := next(tickets)) < len(starts):
            work(starts[ticket], min(starts[ticket] + chunk, n))

    on_threads(min(threads, len(starts)), worker)


def on_threads(threads: int, work: Callable[[], ResultT]) -> list[ResultT]:
    """Call `work()` on `threads` threads at once, including the calling one, and return all results.

    The first exception is raised after all threads have ended.
    """
    if threads == 1:
        return [work()]
    pending = [_executor().submit(work) for _ in range(threads - 1)]
    try:
        results = [work()]
    finally:
        wait(pending)
    return results + [future.result() for future in pending]


def run_chunks(run: Callable[..., int], n: int, chunk: int, threads: int, *arguments: Any) -> int:
    """Call the C function `run(next, n, chunk, *arguments)` on up to `threads` threads.

    The threads take chunks of `range(n)` from the counter `next`, without the interpreter lock. Returns the sum
    of the threads' results; raises `MemoryError` if a result is negative.
    """
    begin = ctypes.c_int64(0)

    def work() -> int:
        return run(ctypes.addressof(begin), n, chunk, *arguments)

    workers = min(threads, -(-n // chunk))
    results = on_threads(workers, work) if workers > 1 else [work()]
    if min(results) < 0:
        raise MemoryError("no memory for the work arrays of a batched evaluation")
    return sum(results)


def _executor() -> ThreadPoolExecutor:
    global _pool
    if _pool is None:
        _pool = ThreadPoolExecutor(max_workers=64, thread_name_prefix="batch")
    return _pool


def _forget_pool() -> None:
    # The threads of a pool do not exist in a forked process; the child starts new threads.
    global _pool
    _pool = None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_pool)


# Number of samples that are transposed at once, so that their rows are still in cache for the next column.
_TILE = 256


class Scratch(threading.local):
    """Named work arrays of each thread, reused because each new page of memory costs a page fault.

    A second request for a name returns the same memory.
    """

    def __init__(self) -> None:
        self._memory: dict[str, np.ndarray] = {}

    def array(self, name: str, *shape: int) -> np.ndarray:
        """Return the work array `name` with this shape, uninitialised."""
        size = math.prod(shape)
        memory = self._memory.get(name)
        if memory is None or len(memory) < size:
            memory = self._memory[name] = np.empty(size)
        return memory[:size].reshape(shape)

    def columns(self, name: str, rows: np.ndarray) -> np.ndarray:
        """Return the contiguous transpose (size, n_samples) of `rows` in the work array `name`."""
        columns = self.array(name, *rows.shape[::-1])
        copy_transposed(rows, columns.T)
        return columns


def copy_transposed(source: np.ndarray, target: np.ndarray) -> None:
    """Copy an array (n_samples, size) in tiles; source or target is the transpose of a contiguous array."""
    for begin in range(0, len(source), _TILE):
        target[begin : begin + _TILE] = source[begin : begin + _TILE]
