"""Progress of a study's loops, reported to a listener."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

T = TypeVar("T")
"""Type of the items of a loop whose progress is reported."""
Listener = Callable[[str, int, int], None]
"""Callback with the name of a loop, the number of its finished items and the number of all items."""
_LISTENER: ContextVar[Listener | None] = ContextVar("listener", default=None)
"""Listener of the current context, or None."""


@contextmanager
def listen_to_progress(listener: Listener) -> Iterator[None]:
    """Send the progress of every study in this context to ``listener``."""
    token = _LISTENER.set(listener)
    try:
        yield
    finally:
        _LISTENER.reset(token)


def report_progress(label: str, done: int, total: int) -> None:
    """Report to the listener, if any, that ``done`` of ``total`` items of the loop ``label`` are finished."""
    if listener := _LISTENER.get():
        listener(label, done, total)


def track_items(label: str, items: Sequence[T]) -> Iterator[T]:
    """Yield the ``items`` of the loop ``label`` and report each finished one to the listener."""
    for done, item in enumerate(items):
        report_progress(label, done, len(items))
        yield item
    report_progress(label, len(items), len(items))
