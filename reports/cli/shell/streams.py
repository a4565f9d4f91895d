"""Standard output and error that take every sign, whatever the terminal's encoding."""

from __future__ import annotations

import codecs
import os
import sys
import unicodedata
from io import TextIOWrapper
from pathlib import Path

from reports.cli.shell import document

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
    for stream in (sys.stdout, document.stream()):
        try:
            stream.flush()
        except OSError:
            with Path(os.devnull).open("w") as nowhere:
                os.dup2(nowhere.fileno(), stream.fileno())
