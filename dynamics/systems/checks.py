"""Checks of what a constructor is given: names, numbers and points, which may be symbols."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, TypeVar

import casadi as ca
import numpy as np

T = TypeVar("T")


def text(what: str, value: Any) -> None:
    """Raise ``ValueError`` unless ``value`` is printable text and not empty."""
    if not (isinstance(value, str) and value.strip() and value.isprintable()):
        raise ValueError(f"{what} must be printable text, such as 'ball', got {value!r}")


def number(what: str, value: Any) -> float | None:
    """The number ``value``, or None for a scalar expression with symbols.

    Raises ``ValueError`` for anything else, and for what is not finite.
    """
    if isinstance(value, ca.SX) and value.is_scalar() and not value.is_constant():
        return None
    kinds = (int, float, np.integer, np.floating, ca.SX, ca.DM)
    array = isinstance(value, np.ndarray) and value.ndim == 0
    if isinstance(value, bool) or not (isinstance(value, kinds) or array) or np.size(value) != 1:
        raise ValueError(f"{what} must be a number or a scalar CasADi expression, got {value!r}")
    found = float(value)
    if not math.isfinite(found):
        raise ValueError(f"{what} must be finite, got {found:g}")
    return found


def positive(what: str, *values: Any) -> None:
    """Raise ``ValueError`` unless every value is a positive number or a scalar expression."""
    for value in values:
        found = number(what, value)
        if found is not None and found <= 0:
            raise ValueError(f"{what} must be positive, got {found:g}")


def not_negative(what: str, value: Any) -> None:
    """Raise ``ValueError`` unless ``value`` is a number >= 0 or a scalar expression."""
    found = number(what, value)
    if found is not None and found < 0:
        raise ValueError(f"{what} must not be negative, got {found:g}")


def point(what: str, value: Any) -> list[float | None]:
    """The two coordinates of a point or vector of the plane, None for each with symbols.

    Raises ``ValueError`` unless ``value`` has two entries, each a number or a scalar expression.
    """
    if isinstance(value, ca.SX | ca.DM):
        two = value.numel() == 2
    else:
        two = isinstance(value, tuple | list | np.ndarray) and np.shape(value)[:1] == (2,)
    if not two:
        raise ValueError(f"{what} must be two numbers, such as (0.1, 0.2), got {value!r}")
    return [number(f"{what}[{i}]", value[i]) for i in range(2)]


def limits(owner: str, value: Any) -> None:
    """Raise ``ValueError`` unless ``value`` is None, or two numbers, the lower one first."""
    low, high = (None, None) if value is None else point(f"{owner} limits", value)
    if low is not None and high is not None and not low < high:
        raise ValueError(f"{owner} limits are {low:g} to {high:g}; expected the lower one first")


def unit(what: str, value: Any) -> None:
    """Raise ``ValueError`` unless ``value`` is a vector of length 1, or has symbols."""
    x, y = point(what, value)
    if x is None or y is None:
        return
    length = math.hypot(x, y)
    if abs(length - 1) > 1e-6:
        mend = f"; use ({x / length:.6g}, {y / length:.6g})" if length else ""
        raise ValueError(f"{what} must have length 1, got ({x:g}, {y:g}){mend}")


def items(what: str, kinds: type[T] | tuple[type[T], ...], values: Any) -> tuple[T, ...]:
    """``values`` as a tuple; raise ``ValueError`` unless each is of one of the ``kinds``."""
    kinds = kinds if isinstance(kinds, tuple) else (kinds,)
    names = " or ".join(kind.__name__ for kind in kinds)
    if not isinstance(values, Iterable) or isinstance(values, str):
        raise ValueError(f"{what} must be a sequence of {names}, got a {type(values).__name__}")
    found = tuple(values)
    for value in found:
        if not isinstance(value, kinds):
            raise ValueError(f"{what} must be a sequence of {names}, it holds {value!r}")
    return found
