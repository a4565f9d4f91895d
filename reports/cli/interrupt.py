"""Ctrl-C, noticed even where compiled code swallows it."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

EXIT_CODE = 130
"""Exit code after Ctrl-C, as shells have it (128 + SIGINT)."""

_seen, _answered = threading.Event(), threading.Event()


@contextmanager
def watched() -> Iterator[None]:
    """Remember a Ctrl-C inside; a second one ends the process at once.

    IPOPT's callback catches Python's KeyboardInterrupt and reports a solve that failed, after
    which a homotopy would go on: :func:`check` raises it again as soon as Python is back.
    """
    _seen.clear()
    _answered.clear()
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, _note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def seen() -> bool:
    """Whether Ctrl-C was pressed, whatever compiled code made of it."""
    return _seen.is_set()


def answered() -> None:
    """Say that a Ctrl-C was heeded, so that it ends nothing more; a second one still does."""
    _answered.set()


def check() -> None:
    """Raise KeyboardInterrupt where Ctrl-C was pressed and did not come through."""
    if seen() and not _answered.is_set():
        raise KeyboardInterrupt


def _note(*_: object) -> None:
    if _seen.is_set():
        os._exit(EXIT_CODE)
    _seen.set()
    raise KeyboardInterrupt
