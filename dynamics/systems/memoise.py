"""Expressions that are built once for each pose."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

import casadi as ca

Built = TypeVar("Built")


class OncePerPose(Generic[Built]):
    """A function of a pose q, called once for each: mass, forces and contacts share sines and cosines."""

    def __init__(self, build: Callable[[ca.SX], Built]) -> None:
        self._build = build
        # The q beside a result keeps its elements alive: a hash of others could be given out again.
        self._results: dict[tuple[int, ...], tuple[ca.SX, Built]] = {}

    def __call__(self, q: ca.SX) -> Built:
        """Return the result at q (nq, 1)."""
        q = ca.SX(q)
        key = tuple(q[i].element_hash() for i in range(q.numel()))
        if key not in self._results:
            self._results[key] = q, self._build(q)
        return self._results[key][1]
