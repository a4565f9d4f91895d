"""What compiled code prints past its own switches, kept from the terminal."""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_ONE = threading.Lock()


@contextmanager
def unheard() -> Iterator[None]:
    """Lose what goes to file descriptor 1 inside; HiGHS has a ``printf`` that nothing turns off."""
    with _ONE, Path(os.devnull).open("w") as nowhere:
        _flush()
        try:
            kept = os.dup(1)
        except OSError:
            kept = -1
        try:
            os.dup2(nowhere.fileno(), 1)
            yield
        finally:
            _flush()
            os.dup2(kept, 1) if kept >= 0 else os.close(1)
            with suppress(OSError):
                os.close(kept)


def _flush() -> None:
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).fflush(None)
