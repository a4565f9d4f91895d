"""With ``--json`` stdout has the one document: whatever else prints there goes to stderr.

Solvers, compilers and a user's own file print where they like, compiled code among them straight
to file descriptor 1, some of it only as the process ends. Hence the descriptor itself is turned
over to stderr, once, and the document is written to a copy of what it was.
"""

from __future__ import annotations

import ctypes
import os
import sys
from contextlib import suppress
from dataclasses import dataclass
from io import BufferedWriter, FileIO, TextIOWrapper, UnsupportedOperation
from pathlib import Path
from typing import TextIO

_OUT, _ERR = 1, 2


@dataclass(frozen=True)
class _Kept:
    """Python's stdout as it was, a copy of descriptor 1, and where the document goes of both."""

    stdout: TextIO
    copy: int
    document: TextIO


_kept: list[_Kept] = []


def reserve() -> None:
    """Keep stdout for the document, until :func:`release` or the end of the process."""
    stdout = sys.stdout
    if _kept or stdout is None:
        return
    stdout.flush()
    copy = os.dup(_OUT)
    document = stdout
    if _descriptor(stdout) == _OUT:
        raw = BufferedWriter(FileIO(copy, "w", closefd=False))
        document = TextIOWrapper(raw, stdout.encoding, stdout.errors)
    _kept.append(_Kept(stdout, copy, document))
    sys.stdout = sys.stderr
    try:
        os.dup2(_ERR, _OUT)
    except OSError:
        with Path(os.devnull).open("w") as nowhere:
            os.dup2(nowhere.fileno(), _OUT)


def stream() -> TextIO:
    """Where the document goes."""
    return _kept[0].document if _kept else sys.stdout


def release() -> None:
    """Give stdout back, after what still waits in the buffers of compiled code."""
    if not _kept:
        return
    was = _kept.pop()
    sys.stdout = was.stdout
    if _descriptor(was.stdout) == _OUT:
        was.stdout.flush()
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).fflush(None)
    os.dup2(was.copy, _OUT)
    os.close(was.copy)


def _descriptor(stream: TextIO) -> int | None:
    """Of a stream; None where Python alone has it, as a test's."""
    try:
        return stream.fileno()
    except (UnsupportedOperation, ValueError, AttributeError):
        return None
