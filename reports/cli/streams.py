"""Standard output and error: one JSON document with ``--json``, and any sign in any encoding."""

from __future__ import annotations

import codecs
import ctypes
import os
import sys
import unicodedata
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


def document_stream() -> TextIO:
    """The stream for the document."""
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


SIGNS = {
    "⟂": "_|_", "·": "*", "–": "-", "—": "-", "…": "...", "≤": "<=", "≥": ">=", "≠": "!=",
    "≈": "~", "±": "+-", "×": "x", "→": "->", "←": "<-", "−": "-", "∞": "inf", "√": "sqrt",
    "Δ": "Delta", "∂": "d", "Σ": "Sigma", "α": "alpha", "β": "beta", "γ": "gamma", "δ": "delta",
    "ε": "epsilon", "θ": "theta", "κ": "kappa", "λ": "lam", "μ": "mu", "µ": "u", "π": "pi",
    "ρ": "rho", "σ": "sigma", "τ": "tau", "φ": "phi", "ψ": "psi", "ω": "omega", "‖": "||",
}  # fmt: skip
"""How a sign is written where the encoding lacks it."""
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
    """Let stdout and stderr write what their encoding lacks in other words.

    UTF-8 stays as it is. A program that is asked for ``PYTHONIOENCODING=cp1252``, or finds itself
    in an ASCII locale, must not end at the sign of complementarity.
    """
    codecs.register_error(HANDLER, _replaced)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper) and codecs.lookup(stream.encoding).name != "utf-8":
            stream.reconfigure(errors=HANDLER)


def flush() -> None:
    """Write what waits for stdout now, while its failure can still be told; raises ``OSError``."""
    sys.stdout.flush()


def abandon() -> None:
    """Let what still waits for stdout go nowhere where it cannot be written.

    Python would try it again as it ends, and print a traceback.
    """
    for stream in (sys.stdout, document_stream()):
        try:
            stream.flush()
        except OSError:
            with Path(os.devnull).open("w") as nowhere:
                os.dup2(nowhere.fileno(), stream.fileno())
