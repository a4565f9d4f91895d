"""The route of a complementarity problem: relaxations, then branches, then restoration."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ocp.problem import Reference
from ocp.programs.program import Program
from ocp.programs.solver import Point, Result
from ocp.routes.branches import Branches, land
from ocp.routes.legs import Homotopy, Path
from ocp.routes.outcome import lower
from ocp.routes.relaxations import CentralPath, ScholtesAdaptive, Strategy
from ocp.routes.schedules import rescheduled

End = tuple[Result, Program, bool]
"""Where a route ended, in which program, and whether on the exact law."""


@dataclass(frozen=True)
class Route:
    """Which strategy relaxes the pairs, from sizes ``reference``, and where it starts.

    ``second`` is the strategy for where it lands nowhere. Where its path was hard to follow, the
    cheapest of several answers counts: ``others`` are then followed, each from a start of its own,
    and ``feasible`` gives points of the program in the form "none" that lie on branches, such as
    rolled-out inputs, which are settled there.
    """

    strategy: Strategy
    reference: Reference
    start: Callable[[Any], Point]
    second: Strategy | None = None
    others: Sequence[tuple[Strategy, Callable[[Any], Point]]] = ()
    feasible: Callable[[Program], Iterable[Point]] | None = None


def solve_pairs(follower: Homotopy, route: Route) -> End:
    """Follow a strategy, land on a branch, and go on to better branches."""
    first = by_strategy(follower, route, route.strategy)
    smooth = first[2] and all(record.accepted for record in follower.trace.records)
    branches = Branches(follower)
    landed = [first[0]] if first[2] else []
    for strategy, start in () if smooth else route.others:
        again = by_strategy(follower, replace(route, start=start), strategy)
        landed += [again[0]] if again[2] else []
    if route.feasible is not None and not smooth and (route.others or not landed):
        tried = (branches.settle(point) for point in route.feasible(branches.program))
        landed += [found for found in tried if found is not None]
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
    if isinstance(strategy, CentralPath):
        strategy = strategy.over(follower.nlp_of("none").chains.shape[-1])
    paths = strategy.paths(route.reference)
    source = follower.nlp_of(paths[0].form)
    result, source = along(follower, paths, route.start(source), source)
    landed = land(follower, source, result, improving=False)
    if not landed[2] and result.ok and isinstance(strategy, CentralPath):
        further = strategy.further(route.reference)
        result, source = along(follower, further, result.point, source, warm=True)
        landed = land(follower, source, result, improving=False)
    return landed


def along(
    follower: Homotopy, paths: list[Path], point: Point, source: Program, warm: bool = False
) -> tuple[Result, Program]:
    """Follow paths one after the other, as far as they go, from a point of ``source``."""
    result: Result | None = None
    for path in paths:
        result, source, finished = follower.follow(path, point, warm, source)
        if not finished:
            break
        point, warm = result.point, True
    assert result is not None
    return result, source


SECOND = ScholtesAdaptive()
"""Slower than the default, but it keeps to the constraints where many pairs pull off the path."""
SECOND_FEW = CentralPath(below=False)
"""Where small problems land nowhere: on the central path from the first stage on."""
FEW = 128
"""Pairs up to which several ways are followed where the first was hard to follow."""
_TURNS = 3
WIDE = CentralPath(factor=0.1, wide=10.0, below=False)
"""From where all contacts are felt from afar."""
OTHERS = (WIDE, CentralPath(), CentralPath(), ScholtesAdaptive())
"""Followed from as many perturbed guesses where the path of a small problem was hard to follow."""
RELAXATIONS = (
    CentralPath(),
    WIDE,
    CentralPath(factor=0.3),
    ScholtesAdaptive(),
)
"""Of several starts each takes another: fast from the characteristic sizes; from ten times their
product; slowly; and beside the central path."""
