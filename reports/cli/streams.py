"""Standard output and error: JSON documents, any sign in any encoding, warnings and logs."""

from __future__ import annotations

import codecs
import ctypes
import os
import sys
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from io import BufferedWriter, FileIO, TextIOWrapper, UnsupportedOperation
from pathlib import Path
from typing import TextIO

_OUT, _ERR = 1, 2


@dataclass(frozen=True)
class _Saved:
    """The original stdout, a copy of descriptor 1, and the one of both that takes the document."""

    stdout: TextIO
    copy: int
    document: TextIO


_saved: list[_Saved] = []


def reserve() -> None:
    """Reserve stdout for the document, until :func:`release` or the end of the process.

    Solvers, compilers and a user's own file print anywhere, compiled code straight to descriptor 1,
    some of it only as the process ends. So the descriptor itself is redirected to stderr, and the
    document is written to a copy of the original.
    """
    stdout = sys.stdout
    if _saved or stdout is None:
        return
    stdout.flush()
    copy = os.dup(_OUT)
    document = stdout
    if _descriptor(stdout) == _OUT:
        raw = BufferedWriter(FileIO(copy, "w", closefd=False))
        document = TextIOWrapper(raw, stdout.encoding, stdout.errors)
    _saved.append(_Saved(stdout, copy, document))
    sys.stdout = sys.stderr
    try:
        os.dup2(_ERR, _OUT)
    except OSError:
        with Path(os.devnull).open("w") as nowhere:
            os.dup2(nowhere.fileno(), _OUT)


def document_stream() -> TextIO:
    """The stream for the document."""
    return _saved[0].document if _saved else sys.stdout


def release() -> None:
    """Restore stdout, after flushing the buffers of compiled code."""
    if not _saved:
        return
    was = _saved.pop()
    sys.stdout = was.stdout
    if _descriptor(was.stdout) == _OUT:
        was.stdout.flush()
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).fflush(None)
    os.dup2(was.copy, _OUT)
    os.close(was.copy)


def _descriptor(stream: TextIO) -> int | None:
    """Descriptor of a stream; None for a stream that exists only in Python, as in tests."""
    try:
        return stream.fileno()
    except (UnsupportedOperation, ValueError, AttributeError):
        return None


SIGNS = {
    "⟂": "_|_", "·": "*", "–": "-", "—": "-", "…": "...", "≤": "<=", "≥": ">=", "≠": "!=",
    "≈": "~", "±": "+-", "×": "x", "→": "->", "←": "<-", "−": "-", "∞": "inf", "√": "sqrt",
    "Δ": "Delta", "∂": "d", "Σ": "Sigma", "α": "alpha", "β": "beta", "γ": "gamma", "δ": "delta",
    "ε": "epsilon", "θ": "theta", "κ": "kappa", "λ": "lam", "μ": "mu", "µ": "u", "π": "pi",
    "ρ": "rho", "σ": "sigma", "τ": "tau", "φ": "phi", "ψ": "psi", "ω": "omega", "‖": "||",
}  # fmt: skip
"""Replacements for signs that an encoding lacks."""
HANDLER = "centralpath-signs"


def written(text: str) -> str:
    """``text`` in ASCII: known signs by their names, letters without accents, the rest as ``?``."""
    return "".join(SIGNS.get(sign) or _plain(sign) for sign in text)


def _plain(sign: str) -> str:
    bare = unicodedata.normalize("NFKD", sign).encode("ascii", "ignore").decode()
    return bare or "?"


def _replaced(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return written(error.object[error.start : error.end]), error.end


def prepare() -> None:
    """Let stdout and stderr replace signs that their encoding lacks; UTF-8 is left alone.

    Under ``PYTHONIOENCODING=cp1252`` or an ASCII locale, ``⟂`` would otherwise end the program.
    """
    codecs.register_error(HANDLER, _replaced)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper) and codecs.lookup(stream.encoding).name != "utf-8":
            stream.reconfigure(errors=HANDLER)


def flush() -> None:
    """Flush stdout while a failure can still be reported; raises ``OSError``."""
    sys.stdout.flush()


def abandon() -> None:
    """Discard the buffers of streams that cannot be written.

    Python would flush them again as it ends, and print a traceback.
    """
    for stream in (sys.stdout, document_stream()):
        try:
            stream.flush()
        except OSError:
            with Path(os.devnull).open("w") as nowhere:
                os.dup2(nowhere.fileno(), stream.fileno())


PACKAGES = ("dynamics", "ocp", "problems", "reports")


@contextmanager
def libraries_silenced(quiet: bool) -> Iterator[None]:
    """Print warnings of our own packages as one line each, none where ``quiet``.

    Warnings and logs of libraries are hidden, for a user cannot act on them (matplotlib on a
    read-only home, say); ``python -W error`` still finds them.
    """
    import logging
    import warnings

    nowhere = logging.NullHandler()
    # A root without a handler has every library's warnings printed.
    logging.getLogger().addHandler(nowhere)
    printed = set[str]()

    def show(message: Warning | str, category: type[Warning], *_: object) -> None:
        if category.__module__.partition(".")[0] in PACKAGES and str(message) not in printed:
            printed.add(str(message))
            if not quiet:
                print(f"warning: {message}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.showwarning = show
        try:
            yield
        finally:
            logging.getLogger().removeHandler(nowhere)


@contextmanager
def log_to_stderr(verbosity: int) -> Iterator[None]:
    """Print log records inside: none at 0, INFO at 1, DEBUG from 2 on.

    A line has the milliseconds since the start of the program, the module and the message.
    """
    if verbosity <= 0:
        yield
        return
    import logging

    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter(_FORMAT, style="{"))
    loggers = [logging.getLogger(name) for name in PACKAGES]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.addHandler(handler)
        logger.setLevel(logging.INFO if verbosity == 1 else logging.DEBUG)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.removeHandler(handler)
            logger.setLevel(level)


_FORMAT = "{relativeCreated:9.0f} ms  {name}: {message}"
