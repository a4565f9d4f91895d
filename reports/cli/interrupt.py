"""Ctrl-C, also where compiled code swallows it."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from reports.cli import EXIT_CODE, end

__all__ = ["EXIT_CODE", "answered", "check", "deferred", "seen", "watched"]

_seen, _answered, _deferred = threading.Event(), threading.Event(), threading.Event()


@contextmanager
def watched() -> Iterator[None]:
    """Record a Ctrl-C inside; a second one ends the process at once.

    IPOPT's callback catches Python's KeyboardInterrupt and reports a solve that failed, after
    which a homotopy would go on: :func:`check` raises it again as soon as Python is back.
    """
    _seen.clear()
    _answered.clear()
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before, hook = signal.signal(signal.SIGINT, _note), sys.unraisablehook
    sys.unraisablehook = _quiet(hook)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        sys.unraisablehook = hook


@contextmanager
def deferred() -> Iterator[None]:
    """Only record a first Ctrl-C inside, which :func:`check` then raises between two steps."""
    _deferred.set()
    try:
        yield
    finally:
        _deferred.clear()


def seen() -> bool:
    """Whether Ctrl-C was pressed, even if compiled code swallowed it."""
    return _seen.is_set()


def answered() -> None:
    """Mark a Ctrl-C as handled, so that :func:`check` no longer raises."""
    _answered.set()


def check() -> None:
    """Raise KeyboardInterrupt after a Ctrl-C that is not handled yet."""
    if seen() and not _answered.is_set():
        raise KeyboardInterrupt


def _note(*_: object) -> None:
    if _seen.is_set():
        end()
    _seen.set()
    if not _deferred.is_set():
        raise KeyboardInterrupt


def _quiet(report: Any) -> Any:
    """The hook ``report``, without Ctrl-C, which :func:`check` raises later."""

    def hook(unraisable: Any) -> None:
        if not isinstance(unraisable.exc_value, KeyboardInterrupt):
            report(unraisable)

    return hook
