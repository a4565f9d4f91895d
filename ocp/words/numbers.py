"""One grammar of numbers, for every option of the command line and every word given to Python.

A number is written with the digits 0 to 9, a sign, a point and a power of ten: ``20``, ``-0.5``,
``.5``, ``1e-3``, ``+2E4``. A whole number is a number with nothing behind the point, however it is
written: ``20``, ``2e1`` and ``20.0`` are the same one. Blanks around it count for nothing, and
``-0`` is 0. Nothing else is a number: no ``nan`` or ``inf``, no ``1e999`` or ``1e-999`` that a
double cannot hold, no ``1_000``, ``0x10``, ``1,5`` or digits of another script.
"""

from __future__ import annotations

import math
import re
import sys
from decimal import Decimal
from typing import Any, get_args

import numpy as np

LARGEST = 2**63 - 1
"""No whole number is larger in size."""
_TOO_LARGE = f"a whole number of at most {LARGEST:.2g} in size"
_WHOLE = re.compile(r"[+-]?[0-9]+")
_NUMBER = re.compile(r"[+-]?([0-9]+(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]+)?")
_DIGITS = 30
"""Of a whole number at most; more are not worth reading."""


def number(word: str) -> float | None:
    """The finite number that ``word`` writes, None where it writes none."""
    text = word.strip()
    if not _NUMBER.fullmatch(text):
        return None
    value = float(text)
    lost = value == 0 and re.search("[1-9]", re.split("[eE]", text)[0])
    return value + 0.0 if math.isfinite(value) and not lost else None


def whole(word: str) -> int | None:
    """The whole number that ``word`` writes, None where it writes none."""
    text = word.strip()
    if _WHOLE.fullmatch(text):
        value = int(text) if len(text) <= _DIGITS else LARGEST + 1
        return value if abs(value) <= LARGEST else None
    found = number(text)
    if found is None or not found.is_integer() or abs(found) > LARGEST:
        return None
    # Doubles skip whole numbers beyond 2^53, and 0.99999999999999999 is 1 to them.
    exact = Decimal(text)
    return int(exact) if exact == exact.to_integral_value() else None


def typed(value: Any, kind: Any) -> Any:
    """``value`` for an argument of type ``kind``: a word as the number it writes.

    What ``kind`` takes otherwise, words among it, is returned as it is.

    Raises ``ValueError``, with what was expected, for a word that is no number, for true and false
    in the place of one, for what is not finite, and for whole numbers beyond :data:`LARGEST`.
    """
    kinds = _kinds(kind)
    if not kinds & {int, float} or kinds & {str, tuple, list, dict}:
        return value
    if isinstance(value, np.generic):
        value = value.item()
    if (isinstance(value, str) or value is True or value is False) and bool not in kinds:
        value = _written(str(value), float in kinds)
    if float in kinds and type(value) is int:
        value = float(value) if abs(value) < sys.float_info.max else math.inf
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError("a finite number" if float in kinds else "a whole number")
    if isinstance(value, int) and abs(value) > LARGEST:
        raise ValueError(_TOO_LARGE)
    return value


def _written(word: str, real: bool) -> float | int:
    found = number(word) if real else whole(word)
    if found is not None:
        return found
    if not real:
        far = _WHOLE.fullmatch(word.strip()) or (number(word) or 0.5).is_integer()
        raise ValueError(_TOO_LARGE if far else "a whole number")
    try:
        float(word)
    except ValueError:
        raise ValueError("a number") from None
    # Python reads more than is a number here: nan, inf, 1_000 and digits of other scripts.
    raise ValueError(
        "a finite number" if word.strip().isascii() and "_" not in word else "a number"
    )


def _kinds(kind: Any) -> set[Any]:
    """The types that ``kind`` is made of, without what annotates them."""
    if not (inner := get_args(kind)):
        return {kind}
    if hasattr(kind, "__metadata__"):
        return _kinds(inner[0])
    origin = getattr(kind, "__origin__", None)
    if isinstance(origin, type):
        return {origin}
    return set().union(*map(_kinds, inner))
