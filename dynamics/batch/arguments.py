"""Checks of a batched call: names, shapes and types of its arguments, and non-finite results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

DEFAULT_BLOCK = 32
"""Default number of samples per block."""


def bind_arguments(positional: Sequence[Any], named: Mapping[str, Any], names: Sequence[str], owner: str) -> list[Any]:
    """Return the arguments in the order of `names`; they are given either all by position or all by name.

    Raises `TypeError`, with the missing, unknown and surplus inputs in its message.
    """
    if positional and named:
        raise TypeError(f"{owner} takes its inputs by position or by name, not both at once")
    if named:
        unknown = [name for name in named if name not in names]
        missing = [name for name in names if name not in named]
        if unknown or missing:
            raise TypeError(
                f"{owner} has inputs {', '.join(names)}; "
                + "; ".join(
                    f"{title} {', '.join(group)}"
                    for title, group in (("unknown:", unknown), ("missing:", missing))
                    if group
                )
            )
        return [named[name] for name in names]
    if len(positional) != len(names):
        raise TypeError(f"{owner} takes {len(names)} inputs ({', '.join(names)}), but {len(positional)} were given")
    return list(positional)


def as_rows(value: Any, size: int, name: str, owner: str) -> np.ndarray:
    """Return `value` as float64 `(n_samples, size)`, or `(1, size)` if its shape is `(size,)`.

    A scalar is accepted for size 1. Raises `ValueError`, with the wrong axis in its message.
    """
    if isinstance(value, np.ndarray) and value.dtype == np.float64 and value.ndim == 2 and value.shape[1] == size:
        return np.ascontiguousarray(value)
    array = as_doubles(value, name, owner)
    if array.ndim == 0 and size == 1:
        array = array.reshape(1)
    if array.ndim not in (1, 2):
        raise ValueError(
            f"input '{name}' of {owner} has {array.ndim} axes; expected (n_samples, {size}), "
            f"or ({size},) shared by all samples"
        )
    if array.shape[-1] != size:
        axis = array.ndim - 1
        hint = ""
        if array.ndim == 1 and size == 1:
            hint = "; write a[:, None] for one value a sample"
        elif array.ndim == 2 and array.shape[0] == size:
            hint = "; samples come first, so transpose it"
        raise ValueError(
            f"input '{name}' of {owner} has {array.shape[-1]} along axis {axis}, expected {size}: "
            f"shape (n_samples, {size}) or ({size},), given {array.shape}{hint}"
        )
    return np.ascontiguousarray(np.atleast_2d(array))


def as_doubles(value: Any, name: str, owner: str) -> np.ndarray:
    """Return `value` as a float64 array; raise `ValueError` unless its elements are real numbers."""
    array = np.asarray(value)
    if array.dtype.kind not in "fiub":
        raise ValueError(f"input '{name}' of {owner} must hold real numbers, not {array.dtype}")
    return array.astype(np.float64, copy=False)


def common_length(rows: Mapping[str, np.ndarray], owner: str, lengths: Mapping[str, int] | None = None) -> int:
    """Return the number of samples of a call; all inputs must have this length, or length 1 if samples share them.

    `lengths` maps further names to numbers of samples that must be the same, even if they are 1.
    Raises `ValueError`, with all numbers of samples in its message, if they differ.
    """
    known_lengths = {name: len(a) for name, a in rows.items() if len(a) != 1} | dict(lengths or {})
    if len(set(known_lengths.values())) > 1:
        listing = ", ".join(f"'{name}' has {length}" for name, length in known_lengths.items())
        raise ValueError(f"inputs of {owner} disagree along axis 0 (samples): {listing}")
    return next(iter(known_lengths.values()), 1)


def as_output(value: np.ndarray | None, shape: tuple[int, ...], name: str) -> np.ndarray:
    """Return the output array: a new array if `value` is None, else `value` after a check of its type and shape."""
    if value is None:
        return np.empty(shape)
    if value.shape != shape or value.dtype != np.float64 or not value.flags.c_contiguous:
        raise ValueError(
            f"out for '{name}' must be a C-contiguous float64 array of shape {shape}, "
            f"not {value.dtype} of shape {value.shape}"
        )
    return value


class BatchWarning(UserWarning):
    """Warning that a backend was replaced because it is unavailable, or that results of samples are not finite."""


@dataclass(frozen=True)
class NonFinite:
    """Samples of one evaluation with a NaN or an infinity: their `count`, and `indices` in ascending order.

    False in a Boolean context when there are none.
    """

    count: int = 0
    indices: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    def __bool__(self) -> bool:
        return self.count > 0

    def __str__(self) -> str:
        listed_indices = ", ".join(map(str, self.indices[:5])) + (", ..." if self.count > 5 else "")
        return f"{self.count} non-finite sample{'s' * (self.count != 1)}, at index {listed_indices}"


def non_finite_rows(arrays: list[np.ndarray]) -> NonFinite:
    """Return the rows (axis 0) that contain a NaN or an infinity in any of the arrays, which have equal lengths."""
    is_nonfinite = np.zeros(len(arrays[0]), dtype=bool)
    for array in arrays:
        is_nonfinite |= ~np.isfinite(array.reshape(len(array), -1)).all(axis=1)
    indices = np.flatnonzero(is_nonfinite)
    return NonFinite(len(indices), indices)
