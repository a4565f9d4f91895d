"""What a sweep goes over: names with their values, read from words such as ``M=0.5:2:7``."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ocp.errors import InputError
from ocp.validation import number

GRAMMAR = "NAME=A:B:n, or NAME=A:B:n:log in equal ratios"
MOST = 100_000
"""Points of one sweep."""
_DIGITS = 12
"""Significant digits of a value, so that 0.3 is 0.3 and is found by that."""


@dataclass(frozen=True)
class Axis:
    """A name as it was given, and the values (n,) it takes; ``log``: drawn in equal ratios."""

    name: str
    values: tuple[float, ...]
    log: bool = False


def axes(over: Mapping[str, Any] | Iterable[str | Axis]) -> tuple[Axis, ...]:
    """Read axes: words of :data:`GRAMMAR`, or values by name, each an array or ``"A:B:n"``.

    Raises :class:`~ocp.errors.InputError` for none, a name twice, what does not read so, and more
    than :data:`MOST` points.
    """
    if isinstance(over, Mapping):
        found = [_of(str(name), values) for name, values in over.items()]
    else:
        found = [one if isinstance(one, Axis) else axis(one) for one in over]
    if not found:
        raise InputError(f"a sweep needs a parameter; give --over {GRAMMAR}")
    names = [one.name for one in found]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"--over: {twice[0]} is given twice; give it once")
    count = math.prod(len(one.values) for one in found)
    if count > MOST:
        raise InputError(f"a grid of {count} points is more than {MOST}; take fewer values")
    return tuple(found)


def axis(text: str) -> Axis:
    """Read ``M=0.5:2:7`` or ``contact.mu=1e-4:1e-1:4:log``; raises as :func:`axes` does."""
    name, sign, values = (part.strip() for part in text.partition("="))
    if not (name and sign and values):
        raise InputError(f"--over: expected {GRAMMAR}, got {text!r}; say --over M=0.5:2:7")
    return _of(name, values)


def _of(name: str, values: Any) -> Axis:
    if isinstance(values, str):
        return _spaced(name, values.split(":"))
    given = np.atleast_1d(np.asarray(values, dtype=float))
    if given.ndim != 1 or not given.size or not np.all(np.isfinite(given)):
        raise InputError(f"--over {name}: expected finite numbers in a row, got {values!r}")
    if len(set(given.tolist())) < given.size:
        raise InputError(f"--over {name}: a value is given twice; give each once")
    return Axis(name, tuple(given.tolist()), _ratios(given))


def _spaced(name: str, parts: Sequence[str]) -> Axis:
    if len(parts) not in (3, 4) or (len(parts) == 4 and parts[3].strip() != "log"):
        raise InputError(f"--over {name}: expected {GRAMMAR}, got {':'.join(parts)!r}")
    first, last = (_number(name, part) for part in parts[:2])
    count = _number(name, parts[2])
    if not (count.is_integer() and 2 <= count <= MOST):
        raise InputError(
            f"--over {name}: n must be a whole number from 2 to {MOST}, got {parts[2].strip()};"
            f" a single value goes with -p {name}=..."
        )
    if first == last:
        raise InputError(f"--over {name}: both ends are {first:g}; give two that differ")
    log = len(parts) == 4
    if log and not (first > 0 and last > 0):
        raise InputError(
            f"--over {name}: equal ratios need ends above zero, got {first:g} and {last:g}; leave"
            " out :log"
        )
    spaced = (np.geomspace if log else np.linspace)(first, last, int(count))
    values = tuple(float(f"{value:.{_DIGITS}g}") for value in spaced)
    if len(set(values)) < len(values):
        raise InputError(f"--over {name}: {int(count)} values between {first:g} and {last:g} are"
                         " not told apart by 12 digits; take fewer")  # fmt: skip
    return Axis(name, values, log)


def _number(name: str, text: str) -> float:
    if (value := number(text)) is None:
        raise InputError(f"--over {name}: expected {GRAMMAR}, got {text.strip()!r} for a number")
    return value


def _ratios(values: np.ndarray) -> bool:
    """Whether more than two values stand in equal ratios rather than in equal steps."""
    if values.size < 3 or np.any(values <= 0):
        return False
    steps, ratios = np.diff(values), np.diff(np.log(values))
    return bool(np.ptp(ratios) / abs(ratios.mean()) < np.ptp(steps) / abs(steps.mean()))
