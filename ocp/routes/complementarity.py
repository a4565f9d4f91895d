"""The route of a complementarity problem: relaxations, then branches, then restoration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ocp.problem import Reference
from ocp.program import Program
from ocp.routes.branches import land
from ocp.routes.legs import Homotopy, Path, translate
from ocp.routes.relaxations import AVERAGED_STRATEGY, STRATEGIES, CentralPath
from ocp.solver import Point, Result

End = tuple[Result, Program, bool]
"""Where a route ended, in which program, and whether on the exact law."""


@dataclass(frozen=True)
class Route:
    """Which strategy relaxes the pairs, from sizes ``reference``, and where it starts."""

    strategy: str
    reference: Reference
    start: Callable[[Any], Point]
    second: str | None = None


def solve_pairs(follower: Homotopy, route: Route) -> End:
    """Follow a strategy, land on a branch and improve it; ``second`` where that does not land."""
    end = by_strategy(follower, route, route.strategy)
    if end[2] or route.second is None:
        return end
    again = by_strategy(follower, route, route.second)
    return again if again[2] else end


def by_strategy(follower: Homotopy, route: Route, name: str, improving: bool = True) -> End:
    """Follow one strategy and land on a branch, which is improved unless told otherwise."""
    strategy = STRATEGIES[name]()
    paths = strategy.paths(route.reference)
    source = follower.nlp_of(paths[0].plan(paths[0].values[0]).form)
    result, source = along(follower, paths, route.start(source), source)
    landed = land(follower, source, result, improving)
    if not landed[2] and result.ok and isinstance(strategy, CentralPath):
        further = strategy.further(route.reference)
        result, source = along(follower, further, result.point, source, warm=True)
        landed = land(follower, source, result, improving)
    return landed


def along(
    follower: Homotopy, paths: list[Path], point: Point, source: Program, warm: bool = False
) -> tuple[Result, Program]:
    """Follow paths one after the other, as far as they go."""
    result: Result | None = None
    for path in paths:
        first = follower.nlp_of(path.plan(path.values[0]).form)
        usable = translate(point, source, first)
        result, source, finished = follower.follow(path, usable, warm or result is not None)
        if not finished:
            break
        point = result.point
    assert result is not None
    return result, source


SECOND = AVERAGED_STRATEGY
"""Slower than the default, but it keeps to the constraints where many pairs pull off the path."""
