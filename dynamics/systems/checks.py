"""Checks of constructor arguments: names, numbers and points, which may be symbolic."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, TypeVar

import casadi as ca
import numpy as np

T = TypeVar("T")


def require_text(name: str, value: Any) -> None:
    """Raise ``ValueError`` unless ``value`` is printable text and not empty."""
    if not (isinstance(value, str) and value.strip() and value.isprintable()):
        raise ValueError(f"{name} must be printable text, such as 'ball', got {value!r}")


def parse_number(name: str, value: Any) -> float | None:
    """Return ``value`` as a float, or None if it is a symbolic scalar expression.

    Raises ``ValueError`` for anything else, and for a number that is not finite.
    """
    if isinstance(value, ca.SX) and value.is_scalar() and not value.is_constant():
        return None
    kinds = (int, float, np.integer, np.floating, ca.SX, ca.DM)
    array = isinstance(value, np.ndarray) and value.ndim == 0
    several = isinstance(value, ca.SX | ca.DM) and not value.is_scalar()
    if isinstance(value, bool) or several or not (isinstance(value, kinds) or array):
        raise ValueError(f"{name} must be a number or a scalar CasADi expression, got {value!r}")
    value_as_float = float(value)
    if not math.isfinite(value_as_float):
        raise ValueError(f"{name} must be finite, got {value_as_float:g}")
    return value_as_float


def require_positive(name: str, *values: Any) -> None:
    """Raise ``ValueError`` unless every value is a positive number or a scalar expression."""
    for value in values:
        known_value = parse_number(name, value)
        if known_value is not None and known_value <= 0:
            raise ValueError(f"{name} must be positive, got {known_value:g}")


def require_not_negative(name: str, value: Any) -> None:
    """Raise ``ValueError`` unless ``value`` is a number >= 0 or a scalar expression."""
    known_value = parse_number(name, value)
    if known_value is not None and known_value < 0:
        raise ValueError(f"{name} must not be negative, got {known_value:g}")


def parse_point(name: str, value: Any) -> list[float | None]:
    """Return the two coordinates of a point or vector in the plane, None for a symbolic one.

    Raises ``ValueError`` unless ``value`` has two entries, each a number or a scalar expression.
    """
    if isinstance(value, ca.SX | ca.DM):
        has_two_entries = value.numel() == 2
    else:
        has_two_entries = isinstance(value, tuple | list | np.ndarray) and np.shape(value)[:1] == (2,)
    if not has_two_entries:
        raise ValueError(f"{name} must be two numbers, such as (0.1, 0.2), got {value!r}")
    return [parse_number(f"{name}[{i}]", value[i]) for i in range(2)]


def require_limits(owner: str, value: Any) -> None:
    """Raise ``ValueError`` unless ``value`` is None or a pair of numbers, the lower first."""
    low, high = (None, None) if value is None else parse_point(f"{owner} limits", value)
    if low is not None and high is not None and not low < high:
        raise ValueError(f"{owner} limits are {low:g} to {high:g}; expected the lower one first")


def require_unit_vector(name: str, entries: Sequence[float | None]) -> None:
    """Raise ``ValueError`` unless a vector with these entries has length 1 or a symbolic entry (None)."""
    known_entries = [entry for entry in entries if entry is not None]
    length = math.hypot(*known_entries)
    if len(known_entries) == len(entries) and abs(length - 1) > 1e-6:
        unit_vector = ", ".join(f"{entry / length:.6g}" for entry in known_entries) if length else ""
        advice = f"; use ({unit_vector})" if length else ""
        raise ValueError(f"{name} must have length 1, got ({', '.join(f'{v:g}' for v in known_entries)}){advice}")


def require_items(name: str, kinds: type[T] | tuple[type[T], ...], values: Any) -> tuple[T, ...]:
    """Return ``values`` as a tuple; raise ``ValueError`` unless each is an instance of one of the ``kinds``."""
    kinds = kinds if isinstance(kinds, tuple) else (kinds,)
    names = " or ".join(kind.__name__ for kind in kinds)
    if not isinstance(values, Iterable) or isinstance(values, str):
        raise ValueError(f"{name} must be a sequence of {names}, got a {type(values).__name__}")
    checked_items = tuple(values)
    for value in checked_items:
        if not isinstance(value, kinds):
            raise ValueError(f"{name} must be a sequence of {names}, but contains {value!r}")
    return checked_items
