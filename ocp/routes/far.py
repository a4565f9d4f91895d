"""Contact schedules far from one: plans rolled out, of which one of every kind is settled."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ocp.programs.solver import Point, Result
from ocp.routes.branches import Branches

_SETTLED = 8
"""Plans that are settled at most."""
_ITERATIONS = 128
"""Of a branch: it has a feasible point near, or often none."""
_APART = 0.125
"""Shares of the horizon by which all contacts together lie apart in schedules of two kinds."""
_FEASIBLE = 1e-6
"""Violation, in natural units, of a plan that keeps its limits."""


def elsewhere(branches: Branches, points: Sequence[Point], below: float) -> list[Result]:
    """Settle the cheapest of ``points`` that keep all limits, of every kind of schedule one.

    An event that falls some steps earlier or later, or one more of them, makes another minimum,
    often in a valley of its own that no exchange of neighbours leads to. A point must cost less
    than ``below``; where that is infinite, points that break limits come after the others, so that
    eight are settled if there are as many.
    """
    program, seen, landed = branches.program, [], []
    for point in _ordered(branches, points, below):
        active = branches.schedule(point.x)
        if all(_apart(active, other, program.chains) > _APART for other in seen):
            seen.append(active)
            found = branches.settle(point, _ITERATIONS)
            landed += [] if found is None else [found]
        if len(seen) == _SETTLED:
            break
    return landed


def _ordered(branches: Branches, points: Sequence[Point], below: float) -> Iterator[Point]:
    program, limits = branches.program, branches.limits
    broken: list[tuple[float, Point]] = []
    for point in points:
        f, g = program.values(point.x, branches.p)
        off = np.maximum(limits["lbg"] - g, g - limits["ubg"]) / program.natural.g
        amount = float(off.max(initial=0.0))
        if amount > _FEASIBLE:
            broken.append((amount, point))
        elif f < below:
            yield point
    if np.isinf(below):
        yield from (point for _, point in sorted(broken, key=lambda one: one[0]))


def _apart(one: np.ndarray, other: np.ndarray, chains: np.ndarray) -> float:
    """Steps by which contacts are moved from one schedule to another, over those of the horizon."""
    moved = np.cumsum(one[chains].astype(int) - other[chains].astype(int), axis=1)
    return float(np.abs(moved).sum() / chains.shape[1])
