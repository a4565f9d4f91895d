"""The route of a complementarity problem: relaxations, then branches, then restoration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ocp.problem import Reference
from ocp.programs.program import Program
from ocp.programs.solver import Point, Result
from ocp.routes.branches import Branches, land
from ocp.routes.far import elsewhere
from ocp.routes.legs import STEP_BACKS, Homotopy, Path
from ocp.routes.outcome import lower
from ocp.routes.relaxations import CentralPath, ScholtesAdaptive, Strategy
from ocp.routes.rolls import Rolls
from ocp.routes.schedules import rescheduled

End = tuple[Result, Program, bool]
"""Where a route ended, in which program, and whether on the exact law."""


@dataclass(frozen=True)
class Route:
    """Which strategy relaxes the pairs, from sizes ``reference``, and where it starts.

    ``second`` is the strategy for where it lands nowhere. ``rolls`` roll inputs out, and what they
    do is settled (:mod:`~ocp.routes.far`): a few after a path that was easy to follow, else many,
    and then ``beside`` are followed from the same start. The cheapest of all answers counts.
    """

    strategy: Strategy
    reference: Reference
    start: Callable[[Any], Point]
    second: Strategy | None = None
    beside: Sequence[Strategy] = ()
    rolls: Rolls | None = None


def solve_pairs(follower: Homotopy, route: Route) -> End:
    """Follow a strategy, land on a branch, and go on to better branches."""
    first = by_strategy(follower, route, route.strategy)
    smooth = first[2] and all(record.accepted for record in follower.trace.records)
    branches = Branches(follower)
    landed = [first[0]] if first[2] else []
    if route.rolls is not None and route.beside:
        count, below = (_SMOOTH, first[0].f) if smooth else (_ROUGH, np.inf)
        points = route.rolls.around(branches.program, [one.point for one in landed], count)
        landed += elsewhere(branches, points, below)
    for strategy in () if smooth else route.beside:
        again = by_strategy(follower, route, strategy)
        landed += [again[0]] if again[2] else []
    hard = not smooth and not any(lower(one, first[0]) or not first[2] for one in landed)
    if route.rolls is not None and hard and (route.beside or not landed):
        tried = (branches.settle(one) for one in route.rolls.shaken(branches.program, _SHAKEN))
        landed += [one for one in tried if one is not None]
    if not landed and route.second is not None:
        again = by_strategy(follower, route, route.second)
        landed = [again[0]] if again[2] else []
    if not landed:
        return first
    best = min(landed, key=lambda found: found.f)
    return improved(branches, best), branches.program, True


def improved(branches: Branches, settled: Result) -> Result:
    """Exchange branches to first order, and schedules for neighbouring ones, in turn."""
    best = branches.improve(settled)
    for _ in range(_TURNS):
        found = rescheduled(branches, best)
        if not lower(found, best):
            return best
        best = branches.improve(found)
        if not lower(best, found):
            return best
    return best


def by_strategy(follower: Homotopy, route: Route, strategy: Strategy) -> End:
    """Follow one strategy and land on a branch, which is not improved."""
    step_backs = 0 if route.beside and strategy not in route.beside else STEP_BACKS
    if isinstance(strategy, CentralPath):
        strategy = strategy.over(follower.nlp_of("none").chains.shape[-1])
    paths = strategy.paths(route.reference)
    source = follower.nlp_of(paths[0].form)
    result, source = along(follower, paths, route.start(source), source, step_backs=step_backs)
    landed = land(follower, source, result, improving=False)
    if not landed[2] and result.ok and isinstance(strategy, CentralPath):
        further = strategy.further(route.reference)
        result, source = along(follower, further, result.point, source, warm=True)
        landed = land(follower, source, result, improving=False)
    return landed


def along(
    follower: Homotopy,
    paths: list[Path],
    point: Point,
    source: Program,
    warm: bool = False,
    step_backs: int = STEP_BACKS,
) -> tuple[Result, Program]:
    """Follow paths one after the other, as far as they go, from a point of ``source``."""
    result: Result | None = None
    for path in paths:
        result, source, finished = follower.follow(path, point, warm, source, step_backs)
        if not finished:
            break
        point, warm = result.point, True
    assert result is not None
    return result, source


SECOND = ScholtesAdaptive()
"""Slower than the default, but it keeps to the constraints where many pairs pull off the path."""
SECOND_FEW = CentralPath(below=False)
"""Where small problems land nowhere: on the central path from the first stage on."""
FEW_ITERATIONS = 128
"""Of a stage of a small problem, after which it is rather landed from where it is."""
FEW = 128
"""Pairs up to which several ways are followed where the first was hard to follow."""
_TURNS = 3
_SMOOTH, _ROUGH = 6, 48
"""Plans rolled out around each known one, after a path that was easy to follow or was not."""
_SHAKEN = 8
"""Guesses that are rolled out where that led to nothing better."""
WIDE = CentralPath(factor=0.1, wide=10.0, below=False)
"""From where all contacts are felt from afar."""
BESIDE = tuple(replace(one, most=FEW_ITERATIONS) for one in (WIDE, ScholtesAdaptive()))
"""Followed too, with steps back, where the path of a small problem was hard to follow."""
RELAXATIONS = (
    CentralPath(),
    WIDE,
    CentralPath(factor=0.3),
    ScholtesAdaptive(),
)
"""Of several starts each takes another: fast from the characteristic sizes; from ten times their
product; slowly; and beside the central path."""
