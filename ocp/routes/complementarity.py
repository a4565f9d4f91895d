"""The route of a complementarity problem: relaxations, then branches, then restoration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ocp.problem import Scaling
from ocp.programs.program import Program
from ocp.programs.solver import Point, Result
from ocp.routes.branches import Branches, polish
from ocp.routes.homotopy import STEP_BACKS, Homotopy, HomotopyPath, lower
from ocp.routes.relaxations import CentralPath, ScholtesAdaptive, Strategy
from ocp.routes.rollouts import RolloutStarts
from ocp.routes.schedules import distant_schedules, improved

End = tuple[Result, Program, bool]
"""Where a route ended, in which program, and whether on the exact law."""


@dataclass(frozen=True)
class Route:
    """Which strategy relaxes the pairs, from sizes ``scaling``, and where it starts.

    ``fallback`` is the strategy to use where it ends on no branch. ``rolls`` roll inputs out, whose
    branches are then solved (:mod:`~ocp.routes.schedules`): a few after a path that was
    easy to follow, else many, and then ``alternatives`` are followed from the same start. The
    cheapest of all answers counts.
    """

    strategy: Strategy
    scaling: Scaling
    start: Callable[[Any], Point]
    fallback: Strategy | None = None
    alternatives: Sequence[Strategy] = ()
    rolls: RolloutStarts | None = None


def solve_pairs(follower: Homotopy, route: Route) -> End:
    """Follow a strategy, solve the branch where it ends, and go on to better branches."""
    first = by_strategy(follower, route, route.strategy)
    smooth = first[2] and all(record.accepted for record in follower.trace.records)
    branches = Branches(follower)
    polished = [first[0]] if first[2] else []
    if route.rolls is not None and route.alternatives:
        count, below = (_SMOOTH, first[0].f) if smooth else (_ROUGH, np.inf)
        points = route.rolls.around(branches.program, [one.point for one in polished], count)
        polished += distant_schedules(branches, points, below)
    for strategy in () if smooth else route.alternatives:
        again = by_strategy(follower, route, strategy)
        polished += [again[0]] if again[2] else []
    hard = not smooth and not any(lower(one, first[0]) or not first[2] for one in polished)
    if route.rolls is not None and hard and (route.alternatives or not polished):
        points = route.rolls.perturbed(branches.program, _PERTURBED)
        tried = map(branches.solve_branch, points)
        polished += [one for one in tried if one is not None]
    if not polished and route.fallback is not None:
        again = by_strategy(follower, route, route.fallback)
        polished = [again[0]] if again[2] else []
    if not polished:
        return first
    best = min(polished, key=lambda found: found.f)
    return improved(branches, best), branches.program, True


def by_strategy(follower: Homotopy, route: Route, strategy: Strategy) -> End:
    """Follow one strategy and solve the branch where it ends, without improving it."""
    step_backs = 0 if route.alternatives and strategy not in route.alternatives else STEP_BACKS
    if isinstance(strategy, CentralPath):
        strategy = strategy.over(follower.nlp_of("none").chains.shape[-1])
    paths = strategy.paths(route.scaling)
    source = follower.nlp_of(paths[0].reformulation)
    result, source = along(follower, paths, route.start(source), source, step_backs=step_backs)
    polished = polish(follower, source, result, improving=False)
    if not polished[2] and result.ok and isinstance(strategy, CentralPath):
        further = strategy.further(route.scaling)
        result, source = along(follower, further, result.point, source, warm=True)
        polished = polish(follower, source, result, improving=False)
    return polished


def along(
    follower: Homotopy,
    paths: list[HomotopyPath],
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


FALLBACK = ScholtesAdaptive()
"""Slower than the default, but it keeps to the constraints where many pairs pull off the path."""
FALLBACK_SMALL = CentralPath(below=False)
"""Where small problems end on no branch: on the central path from the first stage on."""
SMALL_ITERATIONS = 128
"""Of a stage of a small problem, after which it is polished from where it is."""
SMALL_PAIRS = 128
"""Pairs up to which several ways are followed where the first was hard to follow."""
_SMOOTH, _ROUGH = 6, 48
"""Plans rolled out around each known one, after a path that was easy to follow or was not."""
_PERTURBED = 8
"""Guesses that are rolled out where that led to nothing better."""
WIDE = CentralPath(factor=0.1, wide=10.0, below=False)
"""From where all contacts are felt from afar."""
ALTERNATIVES = tuple(replace(one, most=SMALL_ITERATIONS) for one in (WIDE, ScholtesAdaptive()))
"""Followed too, with steps back, where the path of a small problem was hard to follow."""
RELAXATIONS = (
    CentralPath(),
    WIDE,
    CentralPath(factor=0.3),
    ScholtesAdaptive(),
)
"""Of several starts each takes another: fast from the characteristic sizes; from ten times their
product; slowly; and beside the central path."""
