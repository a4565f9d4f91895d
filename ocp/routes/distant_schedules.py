"""Contact schedules far from one: rolled-out plans, one branch of every kind solved."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ocp.programs.solver import Point, Result
from ocp.routes.branches import Branches

_MOST = 8
"""Branches solved at most."""
_ITERATIONS = 128
"""Of a branch: it has a feasible point near, or often none."""
_APART = 0.125
"""Shares of the horizon by which all contacts together lie apart in schedules of two kinds."""
_FEASIBLE = 1e-6
"""Violation, in natural units, of a plan that keeps its limits."""


def distant_schedules(branches: Branches, points: Sequence[Point], below: float) -> list[Result]:
    """Solve the branches of the cheapest feasible ``points``, one of every kind of schedule.

    An event that falls some steps earlier or later, or one more of them, makes another minimum,
    often in a valley of its own that no exchange of neighbours leads to. A point must cost less
    than ``below``; where that is infinite, points that break limits come after the others, so that
    eight are solved if there are as many.
    """
    program, seen, polished = branches.program, [], []
    for point in _ordered(branches, points, below):
        active = branches.schedule(point.x)
        if all(_apart(active, other, program.chains) > _APART for other in seen):
            seen.append(active)
            found = branches.solve_branch(point, _ITERATIONS)
            polished += [] if found is None else [found]
        if len(seen) == _MOST:
            break
    return polished


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
