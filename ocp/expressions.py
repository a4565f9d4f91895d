"""Expressions of a problem: columns of a known size, in declared symbols."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import casadi as ca
import numpy as np

from ocp.errors import InputError, abbreviated


def column(what: str, value: Any, *sizes: int) -> ca.SX:
    """Return numbers or an expression as a column, whose number of entries is one of ``sizes``.

    Raises :class:`~ocp.errors.InputError` for anything else.
    """
    found = _expression(value)
    if found is None:
        raise InputError(
            f"{what} must be numbers or an expression of ca.SX, got {abbreviated(value)}"
        )
    if min(found.shape) > 1:
        raise InputError(f"{what} must be a column, got a matrix of shape {found.shape}")
    if sizes and found.numel() not in sizes:
        raise InputError(f"{what} has {found.numel()} entries, expected {sizes[0]}")
    return ca.vec(found)


def check_symbols(what: str, value: ca.SX, known: Iterable[ca.SX], expected: str) -> None:
    """Raise :class:`~ocp.errors.InputError` where ``value`` uses a symbol that is not known.

    ``expected`` describes which ones are.
    """
    declared = {symbol.element_hash() for part in known for symbol in ca.symvar(part)}
    used = ca.symvar(value)
    strange = sorted({str(one) for one in used if one.element_hash() not in declared})
    if strange:
        raise InputError(f"{what} uses {', '.join(strange)}, which is {expected}")


def _expression(value: Any) -> ca.SX | None:
    if isinstance(value, np.ndarray | list | tuple) and not _numbers(value):
        return None
    if not isinstance(value, ca.SX | ca.DM | int | float | np.generic | np.ndarray | list | tuple):
        return None
    if isinstance(value, bool | np.bool_ | np.complexfloating | np.str_ | np.bytes_):
        return None
    return ca.SX(value.item() if isinstance(value, np.generic) else value)


def _numbers(values: Any) -> bool:
    try:
        return np.asarray(values).dtype.kind in "if"
    except (ValueError, TypeError, OverflowError):
        return False
