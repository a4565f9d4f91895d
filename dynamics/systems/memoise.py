"""Cache of expressions that depend on a pose."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

import casadi as ca

Built = TypeVar("Built")


class OncePerPose(Generic[Built]):
    """A function of a pose q that is evaluated once per pose, so that its results share sines and cosines."""

    def __init__(self, build: Callable[[ca.SX], Built]) -> None:
        self._build = build
        # A result is stored with its q, since the hash of an element that is freed could be reused.
        self._results: dict[tuple[int, ...], tuple[ca.SX, Built]] = {}

    def __call__(self, q: ca.SX) -> Built:
        """Return the result at q (nq, 1)."""
        q = ca.SX(q)
        key = tuple(q[i].element_hash() for i in range(q.numel()))
        if key not in self._results:
            self._results[key] = q, self._build(q)
        return self._results[key][1]
