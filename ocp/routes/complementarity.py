"""The route of a complementarity problem: relaxations, then branches, then restoration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ocp.programs.program import Program
from ocp.programs.solver import Point, Result
from ocp.routes.branches import Branches, polish
from ocp.routes.homotopy import STEP_BACKS, Homotopy, HomotopyPath, RouteResult, lower
from ocp.routes.relaxations import CentralPath, ScholtesAdaptive, Strategy
from ocp.routes.rollouts import RolloutStarts
from ocp.routes.schedules import MAX_FAILURES, distant_schedules, improved


@dataclass(frozen=True)
class RelaxationPlan:
    """Strategy that relaxes the pairs, from ``mu`` in natural units on, and its start.

    ``fallback`` is the strategy to use where it ends on no branch. ``rolls`` roll inputs out, whose
    branches are then solved (:mod:`~ocp.routes.schedules`): a few after a path that was
    easy to follow, else many, and then ``alternatives`` are followed from the same start. Where
    few inputs act, rollouts cover their whole range instead. The cheapest of all answers counts.
    """

    strategy: Strategy
    mu: float
    start: Callable[[Any], Point]
    fallback: Strategy | None = None
    alternatives: Sequence[Strategy] = ()
    rolls: RolloutStarts | None = None


def solve_pairs(follower: Homotopy, search: RelaxationPlan) -> RouteResult:
    """Follow a strategy, solve the branch where it ends, and go on to better branches.

    Where rollouts cover the few inputs that act, no path is followed unless they lead nowhere.
    """
    branches = Branches(follower)
    if search.rolls is not None and search.alternatives:
        covering_results = cover_inputs(branches, search.rolls)
        if covering_results:
            return _best(branches, covering_results, COVERED_FAILURES)
    first = by_strategy(follower, search, search.strategy)
    easy = first.finished and all(record.accepted for record in follower.trace.records)
    polished = [first.result] if first.finished else []
    if search.rolls is not None and search.alternatives:
        count, cost_limit = (ROLLOUTS_AFTER_EASY_PATH, first.result.f) if easy else (ROLLOUTS_AFTER_HARD_PATH, np.inf)
        points = search.rolls.around(branches.program, [candidate.point for candidate in polished], count)
        polished += distant_schedules(branches, points, cost_limit)
    for strategy in () if easy else search.alternatives:
        retried = by_strategy(follower, search, strategy)
        polished += [retried.result] if retried.finished else []
    no_gain = not easy and not any(lower(candidate, first.result) or not first.finished for candidate in polished)
    if search.rolls is not None and no_gain and (search.alternatives or not polished):
        points = search.rolls.perturbed(branches.program, _PERTURBED)
        rolled_results = map(branches.solve_branch, points)
        polished += [candidate for candidate in rolled_results if candidate is not None]
    if not polished and search.fallback is not None:
        retried = by_strategy(follower, search, search.fallback)
        polished = [retried.result] if retried.finished else []
    return _best(branches, polished) if polished else first


def cover_inputs(branches: Branches, rolls: RolloutStarts) -> list[Result]:
    """Branches of the cheapest rollouts over the whole range of the inputs, where few act."""
    if not 0 < rolls.acting_inputs.sum() <= COVERED_INPUTS:
        return []
    points = rolls.sample_range(branches.program, COVERING_ROLLOUTS, REFINED_ROLLOUTS, ROLLOUTS_AROUND)
    return distant_schedules(branches, points, np.inf, COVERED_BRANCHES)


def _best(branches: Branches, results: list[Result], max_failures: int = MAX_FAILURES) -> RouteResult:
    best = improved(branches, min(results, key=lambda candidate: candidate.f), max_failures)
    return RouteResult(best, branches.program, True, branches.follower.trace)


def by_strategy(follower: Homotopy, search: RelaxationPlan, strategy: Strategy) -> RouteResult:
    """Follow one strategy and solve the branch where it ends, without improving it."""
    step_backs = 0 if search.alternatives and strategy not in search.alternatives else STEP_BACKS
    if isinstance(strategy, CentralPath):
        strategy = strategy.for_horizon(follower.nlp_of("none").chains.shape[-1])
    paths = strategy.paths(search.mu)
    source = follower.nlp_of(paths[0].reformulation)
    followed = follow_paths(follower, paths, search.start(source), source, step_backs=step_backs)
    polished = polish(follower, followed.nlp, followed.result, improving=False)
    if not polished.finished and followed.result.ok and isinstance(strategy, CentralPath):
        extended_paths = strategy.extend(search.mu)
        followed = follow_paths(follower, extended_paths, followed.result.point, followed.nlp, warm=True)
        polished = polish(follower, followed.nlp, followed.result, improving=False)
    return polished


def follow_paths(
    follower: Homotopy,
    paths: list[HomotopyPath],
    point: Point,
    source: Program,
    warm: bool = False,
    step_backs: int = STEP_BACKS,
) -> RouteResult:
    """Follow paths one after the other, as far as they go, from a point of ``source``."""
    followed: RouteResult | None = None
    for path in paths:
        followed = follower.follow(path, point, warm, source, step_backs)
        if not followed.finished:
            break
        point, warm, source = followed.result.point, True, followed.nlp
    assert followed is not None
    return followed


FALLBACK = ScholtesAdaptive()
"""Slower than the default, but it keeps to the constraints where many pairs pull off the path."""
FALLBACK_SMALL = CentralPath(start_below=False)
"""Where small problems end on no branch: on the central path from the first stage on."""
SMALL_ITERATIONS = 128
"""Of a stage of a small problem, after which it is polished from where it is."""
SMALL_PAIRS = 128
"""Pairs up to which several ways are followed where the first was hard to follow."""
ROLLOUTS_AFTER_EASY_PATH = 6
"""Plans rolled out around each plan so far, after a path that was easy to follow."""
ROLLOUTS_AFTER_HARD_PATH = 48
"""Plans rolled out around each plan so far, after a path that was hard to follow."""
COVERED_INPUTS = 3
"""Acting inputs up to which rollouts cover all plans."""
COVERING_ROLLOUTS = 1000
"""Rollouts that cover all plans."""
REFINED_ROLLOUTS = 16
"""Covering rollouts that are refined, the cheapest."""
ROLLOUTS_AROUND = 16
"""Rollouts around each that is refined."""
COVERED_BRANCHES = 3
"""Branches solved after covering rollouts."""
COVERED_FAILURES = 4
"""Neighbours tried in vain after covering rollouts: most schedules were rolled out before."""
_PERTURBED = 8
"""Guesses that are rolled out where that led to nothing better."""
WIDE = CentralPath(factor=0.1, start_factor=10.0, start_below=False)
"""From where all contacts are felt from afar."""
ALTERNATIVES = tuple(replace(strategy, max_iterations=SMALL_ITERATIONS) for strategy in (WIDE, ScholtesAdaptive()))
"""Followed too, with steps back, where the path of a small problem was hard to follow."""
RELAXATIONS = (CentralPath(), WIDE, CentralPath(factor=0.3), ScholtesAdaptive())
"""Of several starts each takes another: fast from the characteristic sizes; from ten times their
product; slowly; and beside the central path."""
