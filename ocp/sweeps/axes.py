"""What a sweep goes over: names with their values, read from words such as ``M=0.5:2:7``."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ocp.errors import InputError
from ocp.validation import GRAMMAR, MOST, Axis, spaced

_DIGITS = 12
"""Significant digits of a value, so that 0.3 is 0.3 and is found by that."""


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
    found = spaced("--over", text, least=2)
    name, first, last = found.name, found.values[0], found.values[-1]
    if first == last:
        raise InputError(f"--over {name}: both ends are {first:g}; give two that differ")
    values = tuple(float(f"{value:.{_DIGITS}g}") for value in found.values)
    if len(set(values)) < len(values):
        raise InputError(f"--over {name}: {len(values)} values between {first:g} and {last:g} are"
                         f" equal to {_DIGITS} digits; take fewer")  # fmt: skip
    return Axis(name, values, found.log)


def _of(name: str, values: Any) -> Axis:
    if isinstance(values, str):
        return axis(f"{name}={values}")
    given = np.atleast_1d(np.asarray(values, dtype=float))
    if given.ndim != 1 or not given.size or not np.all(np.isfinite(given)):
        raise InputError(f"--over {name}: expected finite numbers in a row, got {values!r}")
    if len(set(given.tolist())) < given.size:
        raise InputError(f"--over {name}: a value is given twice; give each once")
    return Axis(name, tuple(given.tolist()), _ratios(given))


def _ratios(values: np.ndarray) -> bool:
    """Whether more than two values stand in equal ratios rather than in equal steps."""
    if values.size < 3 or np.any(values <= 0):
        return False
    steps, ratios = np.diff(values), np.diff(np.log(values))
    return bool(np.ptp(ratios) / abs(ratios.mean()) < np.ptp(steps) / abs(steps.mean()))
