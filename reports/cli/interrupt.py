"""Handling of Ctrl-C, also during compiled code that ignores it."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from reports.cli import EXIT_CODE, end

__all__ = [
    "EXIT_CODE",
    "defer_interrupts",
    "mark_handled",
    "raise_if_interrupted",
    "was_interrupted",
    "watch_interrupts",
]

_PRESSED = threading.Event()
"""Event that is set when Ctrl-C is pressed."""
_ANSWERED = threading.Event()
"""Event that is set when a Ctrl-C has been handled."""
_DEFERRED = threading.Event()
"""Event that is set while a first Ctrl-C is only recorded."""


@contextmanager
def watch_interrupts() -> Iterator[None]:
    """Record a Ctrl-C within the context; a second Ctrl-C ends the process at once.

    IPOPT's callback catches Python's KeyboardInterrupt and reports a failed solve, after which a homotopy would
    continue. Therefore :func:`raise_if_interrupted`, called between solves, raises KeyboardInterrupt again.
    """
    _PRESSED.clear()
    _ANSWERED.clear()
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous_handler, hook = signal.signal(signal.SIGINT, _note), sys.unraisablehook
    sys.unraisablehook = _quiet(hook)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous_handler)
        sys.unraisablehook = hook


@contextmanager
def defer_interrupts() -> Iterator[None]:
    """Record a first Ctrl-C within the context; only :func:`raise_if_interrupted` then raises KeyboardInterrupt."""
    _DEFERRED.set()
    try:
        yield
    finally:
        _DEFERRED.clear()


def was_interrupted() -> bool:
    """Return whether Ctrl-C was pressed, even if compiled code ignored it."""
    return _PRESSED.is_set()


def mark_handled() -> None:
    """Mark a Ctrl-C as handled, so that :func:`raise_if_interrupted` no longer raises."""
    _ANSWERED.set()


def raise_if_interrupted() -> None:
    """Raise KeyboardInterrupt after a Ctrl-C that has not been handled."""
    if was_interrupted() and not _ANSWERED.is_set():
        raise KeyboardInterrupt


def _note(*_: object) -> None:
    if _PRESSED.is_set():
        end()
    _PRESSED.set()
    if not _DEFERRED.is_set():
        raise KeyboardInterrupt


def _quiet(report: Any) -> Any:
    """Return a hook that calls ``report`` for all unraisable exceptions except KeyboardInterrupt."""

    def hook(unraisable: Any) -> None:
        if not isinstance(unraisable.exc_value, KeyboardInterrupt):
            report(unraisable)

    return hook
