"""Expressions that are built once for each pose."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import casadi as ca

T = TypeVar("T")


def memoise_expression(store: dict[tuple[int, ...], tuple[ca.SX, T]], q: ca.SX, make: Callable[[], T]) -> T:
    """Return what was made for q before, or make it: mass, forces and contacts share sines and cosines."""
    # The q beside it keeps its elements alive: a hash of others could be given out again.
    key = tuple(q[i].element_hash() for i in range(q.numel()))
    if key not in store:
        store[key] = q, make()
    return store[key][1]
