"""Threads over chunks of samples. Kernels release the interpreter lock while they run."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait

_pool: ThreadPoolExecutor | None = None


def available_threads() -> int:
    """How many CPUs this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def checked_threads(threads: int | None) -> int:
    """`threads`, or every available CPU for None; `ValueError` below one."""
    if threads is None:
        return available_threads()
    if isinstance(threads, bool) or not isinstance(threads, int) or threads < 1:
        raise ValueError(f"threads must be a whole number of at least 1 or None, not {threads!r}")
    return threads


def over_chunks(n: int, chunk: int, threads: int, work: Callable[[int, int], None]) -> None:
    """Call `work(begin, end)` for consecutive chunks of `range(n)` on up to `threads` threads.

    Chunks are taken in turn by whoever is free; their bounds depend on `n` and `chunk` alone, so
    what is computed does not depend on `threads`. The first exception is raised.
    """
    starts = range(0, n, chunk)
    tickets = itertools.count()

    def worker() -> None:
        while (ticket := next(tickets)) < len(starts):
            work(starts[ticket], min(starts[ticket] + chunk, n))

    helpers = min(threads, len(starts)) - 1
    if helpers <= 0:
        worker()
        return
    pending = [_executor().submit(worker) for _ in range(helpers)]
    try:
        worker()
    finally:
        wait(pending)
    for future in pending:
        future.result()


def _executor() -> ThreadPoolExecutor:
    global _pool
    if _pool is None:
        _pool = ThreadPoolExecutor(max_workers=64, thread_name_prefix="batch")
    return _pool


def _forget_pool() -> None:
    # The threads of a pool do not survive a fork; the child makes its own.
    global _pool
    _pool = None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_pool)
