"""Ctrl-C while compiled code runs."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr
from io import StringIO
from types import FrameType


@contextmanager
def noted() -> Iterator[list[int]]:
    """Give a list that holds SIGINT once it came inside; whoever handled it before handles it too.

    CasADi asks Python for signals at every evaluation of a function. IPOPT's interface catches what
    the handler then raises, stops, and gives the iterate that it was at, without another word;
    other plugins let it through. What CasADi warns of then is not printed.
    """
    seen: list[int] = []
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield seen
        return

    silence = ExitStack()

    def note(number: int, frame: FrameType | None) -> None:
        seen.append(number)
        silence.enter_context(redirect_stderr(StringIO()))
        before(number, frame)

    signal.signal(signal.SIGINT, note)
    try:
        yield seen
    finally:
        silence.close()
        signal.signal(signal.SIGINT, before)
