"""The route of a complementarity problem: relaxations, then branches, then restoration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ocp.problem import Reference
from ocp.programs.program import Program
from ocp.programs.solver import Point, Result
from ocp.routes.branches import Branches, land
from ocp.routes.legs import Homotopy, Path, translate
from ocp.routes.relaxations import CentralPath, ScholtesAdaptive, Strategy

End = tuple[Result, Program, bool]
"""Where a route ended, in which program, and whether on the exact law."""


@dataclass(frozen=True)
class Route:
    """Which strategies relax the pairs, from sizes ``reference``, and where they start.

    All ``looks`` are followed and the cheapest end counts; ``second`` is for where none lands.
    """

    looks: Sequence[Strategy]
    reference: Reference
    start: Callable[[Any], Point]
    second: Strategy | None = None


def solve_pairs(follower: Homotopy, route: Route) -> End:
    """Follow strategies, land each on a branch, and improve the cheapest branch.

    A look ends early where its active set shows to be that of an end already found, and then it
    was the last one. So it was where all took four times the iterations of the first.
    """
    ends: list[End] = []
    first = 0
    for look in route.looks:
        known = [end for end in ends if end[2]]
        found = by_strategy(follower, route, look, known)
        if any(found is end for end in known):
            break
        ends.append(found)
        first = first or follower.trace.iterations
        # Without any stage solved the looks that are left would fail as these did.
        stuck = follower.early is None and len(ends) > 1
        if stuck or follower.trace.iterations > _WORTH * first:
            break
    landed = [end for end in ends if end[2]]
    if not landed and route.second is not None:
        again = by_strategy(follower, route, route.second)
        landed = [again] if again[2] else []
    if not landed:
        return ends[0]
    result, program, _ = min(landed, key=lambda end: end[0].f)
    return Branches(follower).improve(result), program, True


def by_strategy(
    follower: Homotopy, route: Route, strategy: Strategy, known: Sequence[End] = ()
) -> End:
    """Follow one strategy and land on a branch, which is not improved; or at a ``known`` end."""
    paths = strategy.paths(route.reference)
    if known:
        paths = [replace(path, complete=partial(_known, known)) for path in paths]
    source = follower.nlp_of(paths[0].plan(paths[0].values[0]).form)
    early = follower.early if known else None
    start = route.start(source) if early is None else early
    result, source = along(follower, paths, start, source, warm=early is not None)
    if result.ok and (same := _known(known, source, result)):
        return same
    landed = land(follower, source, result, improving=False)
    if not (landed[2] or known) and result.ok and isinstance(strategy, CentralPath):
        further = strategy.further(route.reference)
        result, source = along(follower, further, result.point, source, warm=True)
        landed = land(follower, source, result, improving=False)
    return landed


def _known(known: Sequence[End], program: Program, result: Result) -> End | None:
    """The end whose active set a relaxed point has, where each pair has decided."""
    here, decided = _sides(program, result)
    if not decided:
        return None
    return next((end for end in known if np.array_equal(here, _sides(end[1], end[0])[0])), None)


def _sides(program: Program, result: Result) -> tuple[np.ndarray, bool]:
    first, second = (result.point.x / program.sizes(result.point.x))[program.pairs]
    small, large = np.minimum(first, second), np.maximum(first, second)
    return first > second, bool(np.all(small <= _DECIDED * np.maximum(large, _DECIDED)))


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


SECOND = ScholtesAdaptive()
"""Slower than the default, but it keeps to the constraints where many pairs pull off the path."""
SECOND_FEW = CentralPath(below=False)
"""Where small problems land nowhere: on the central path from the first stage on."""
FEW = 128
"""Pairs up to which a problem is looked at twice; a larger one takes its time as it is."""
_WORTH = 4
LOOKS = (
    CentralPath(),
    CentralPath(factor=0.1, wide=10.0, below=False),
    CentralPath(factor=0.3),
    ScholtesAdaptive(),
)
"""Fast from the characteristic sizes; from ten times their product, where all contacts are felt
from afar; slowly; and beside the central path. Where the first two end with the same active set
that is the end, else the cheapest of all counts: none of them is always in the best minimum."""
_DECIDED = 0.3
"""Ratio of a pair's members, in characteristic sizes, below which it is clear which one is zero."""
