"""Route of a complementarity problem: relaxations, then branches, then other contact schedules."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ocp.programs.program import Program
from ocp.programs.solver import Point, Result
from ocp.routes.branches import Branches
from ocp.routes.homotopy import STEP_BACKS, Homotopy, HomotopyPath, RouteResult, lower
from ocp.routes.pieces import on_piece, polish
from ocp.routes.relaxations import STRATEGIES, CentralPath, ColdScholtes, L1Penalty, ScholtesAdaptive, Strategy
from ocp.routes.rollouts import RolloutStarts
from ocp.routes.schedules import MAX_FAILURES, distant_schedules, improve


@dataclass(frozen=True)
class RelaxationPlan:
    """Plan of a relaxation: its strategy, the first ``mu`` in natural units, the start, and further attempts.

    ``after_failure`` is the strategy to follow if the first one fails, before rollouts, which are slow in large
    problems. ``fallback`` is the strategy to use if no branch is solved. ``rolls`` makes rollouts of inputs, whose
    branches are also solved (:mod:`~ocp.routes.schedules`): a few after a path that was easy to follow, many after a
    hard path, for which ``alternatives`` are also followed from the same start. If only few inputs act, rollouts cover
    their whole range instead. Then the ``further_paths`` are followed, each given up once it promises no lower cost
    than the results before it. The cheapest of all results is returned. ``patience`` limits the search for neighbours,
    see :func:`~ocp.routes.schedules.improve_schedule`.
    """

    strategy: Strategy
    mu: float
    start: Callable[[Any], Point]
    after_failure: Strategy | None = None
    fallback: Strategy | None = None
    alternatives: Sequence[Strategy] = ()
    further_paths: Sequence[Strategy] = ()
    rolls: RolloutStarts | None = None
    patience: float = math.inf


def solve_pairs(follower: Homotopy, plan: RelaxationPlan) -> RouteResult:
    """Relax the pairs, solve branches, and then follow the plan's further paths as long as they promise less cost.

    Together these may take :data:`FURTHER_SHARE` times the iterations before them, if there is an answer already.
    """
    branches, trace = Branches(follower), follower.trace
    outcome = _relax(branches, plan)
    iterations_left = FURTHER_SHARE * trace.iterations
    for further_path in plan.further_paths:
        if outcome.finished and iterations_left <= 0:
            break
        cost_limit, iterations_before = outcome.result.f if outcome.finished else np.inf, trace.iterations
        last_iteration = iterations_before + iterations_left if outcome.finished else np.inf
        followed = by_strategy(follower, plan, further_path, cost_limit, last_iteration)
        iterations_left -= trace.iterations - iterations_before
        if followed.finished and (not outcome.finished or lower(followed.result, outcome.result)):
            outcome = _best(branches, [followed.result], plan.patience)
    return outcome


def _relax(branches: Branches, plan: RelaxationPlan) -> RouteResult:
    """Follow a strategy, solve the branch at its end, and exchange it for better branches.

    If rollouts cover the range of a few acting inputs, a path is followed only if they give no result.
    """
    follower = branches.follower
    if plan.rolls is not None and plan.alternatives:
        covering_results = cover_inputs(branches, plan.rolls)
        if covering_results:
            return _best(branches, covering_results, plan.patience, COVERED_FAILURES)
    first = by_strategy(follower, plan, plan.strategy)
    easy = first.finished and all(record.accepted for record in follower.trace.records)
    polished = [first.result] if first.finished else []
    if plan.rolls is not None and plan.alternatives:
        count, cost_limit = (ROLLOUTS_AFTER_EASY_PATH, first.result.f) if easy else (ROLLOUTS_AFTER_HARD_PATH, np.inf)
        points = plan.rolls.around(branches.program, [candidate.point for candidate in polished], count)
        polished += distant_schedules(branches, points, cost_limit)
    detours = [plan.after_failure] if plan.after_failure is not None and not first.finished else []
    for strategy in () if easy else (*detours, *plan.alternatives):
        retried = by_strategy(follower, plan, strategy)
        polished += [retried.result] if retried.finished else []
    no_gain = not easy and not any(lower(candidate, first.result) or not first.finished for candidate in polished)
    if plan.rolls is not None and no_gain and (plan.alternatives or not polished):
        points = plan.rolls.perturbed(branches.program, _PERTURBED)
        rolled_results = map(branches.solve_branch, points)
        polished += [candidate for candidate in rolled_results if candidate is not None]
    if not polished and plan.fallback is not None:
        retried = by_strategy(follower, plan, plan.fallback)
        polished = [retried.result] if retried.finished else []
    return _best(branches, polished, plan.patience) if polished else first


def cover_inputs(branches: Branches, rolls: RolloutStarts) -> list[Result]:
    """Return results on branches of the cheapest rollouts over the range of the inputs; empty if many inputs act."""
    if not 0 < rolls.acting_inputs.sum() <= COVERED_INPUTS:
        return []
    points = rolls.sample_range(branches.program, COVERING_ROLLOUTS, REFINED_ROLLOUTS, ROLLOUTS_AROUND)
    return distant_schedules(branches, points, np.inf, COVERED_BRANCHES)


def _best(branches: Branches, results: list[Result], patience: float, max_failures: int = MAX_FAILURES) -> RouteResult:
    branches, start = on_piece(branches, min(results, key=lambda candidate: candidate.f))
    return branches.result_of_problem(improve(branches, start, max_failures, patience))


def by_strategy(
    follower: Homotopy,
    plan: RelaxationPlan,
    strategy: Strategy,
    cost_limit: float | None = None,
    last_iteration: float = math.inf,
) -> RouteResult:
    """Follow one strategy and solve the branch at its end, without further improvement.

    With a ``cost_limit`` its paths are given up if they promise no lower cost, and have no step-backs; also once the
    follower has taken ``last_iteration`` iterations.
    """
    hurried = bool(plan.alternatives) and strategy not in plan.alternatives
    step_backs = 0 if hurried or cost_limit is not None else STEP_BACKS
    if isinstance(strategy, CentralPath):
        strategy = strategy.for_horizon(follower.nlp_of("none").chains.shape[-1])
    limits = {"cost_limit": np.inf if cost_limit is None else cost_limit, "last_iteration": last_iteration}
    paths = [replace(path, **limits) for path in strategy.paths(plan.mu)]
    source = follower.nlp_of(paths[0].reformulation)
    followed = follow_paths(follower, paths, plan.start(source), source, step_backs=step_backs)
    if cost_limit is not None and not (followed.finished and followed.result.f < cost_limit):
        return replace(followed, finished=False)
    polished = polish(follower, followed.nlp, followed.result, improving=False)
    if not polished.finished and followed.result.ok and isinstance(strategy, CentralPath):
        extended_paths = strategy.extend(plan.mu)
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
    """Follow paths one after another, from a ``point`` of ``source``, until a path does not reach its end."""
    followed: RouteResult | None = None
    for path in paths:
        followed = follower.follow(path, point, warm, source, step_backs)
        if not followed.finished:
            break
        point, warm, source = followed.result.point, True, followed.nlp
    assert followed is not None
    return followed


AFTER_FAILURE = L1Penalty()
"""Strategy after a path of a large problem that failed; it stays near the guess, where the central path need not go."""
FALLBACK = ScholtesAdaptive()
"""Fallback strategy of large problems, slower than the default but more robust with many pairs."""
FALLBACK_SMALL = CentralPath(start_below=False)
"""Fallback strategy of small problems, on the central path from the first stage."""
QUICK_PATIENCE = 0.25
"""Patience of a search for neighbours with quick effort: a quarter of the iterations before it."""
SMALL_ITERATIONS = 128
"""Iteration limit of a stage of a small problem; its last point is then polished."""
SMALL_PAIRS = 128
"""Maximum number of pairs of a small problem, for which several strategies are followed after a hard path."""
ROLLOUTS_AFTER_EASY_PATH = 6
"""Number of plans rolled out around each previous plan, after a path that was easy to follow."""
ROLLOUTS_AFTER_HARD_PATH = 48
"""Number of plans rolled out around each previous plan, after a path that was hard to follow."""
COVERED_INPUTS = 3
"""Maximum number of acting inputs whose range is covered by rollouts."""
COVERING_ROLLOUTS = 1000
"""Number of rollouts that cover the range of the inputs."""
REFINED_ROLLOUTS = 16
"""Number of the cheapest covering rollouts that are refined."""
ROLLOUTS_AROUND = 16
"""Number of rollouts around each covering rollout that is refined."""
COVERED_BRANCHES = 3
"""Maximum number of branches solved after covering rollouts."""
COVERED_FAILURES = 4
"""Number of failed neighbours in a row that ends a search after covering rollouts, which tried most schedules."""
_PERTURBED = 8
"""Number of perturbed guesses that are rolled out if nothing better was found."""
WIDE = CentralPath(factor=0.1, start_factor=10.0, start_below=False)
"""Central path from a large t, at which distant contacts also have forces."""
ALTERNATIVES = tuple(replace(strategy, max_iterations=SMALL_ITERATIONS) for strategy in (WIDE, ScholtesAdaptive()))
"""Additional strategies, with step-backs, if the path of a small problem was hard to follow."""
FURTHER_PATHS = (ColdScholtes(), ColdScholtes(factor=0.01), ColdScholtes(start=1.0), STRATEGIES["scholtes"])
"""Paths after the usual one, which often end in other minima; the first alone at quick effort."""
FURTHER_SHARE = 2.0
"""Maximum ratio of the iterations on these paths to all iterations before them.

Cheaper plans of ``push-box``, ``pushbot`` and ``waiter`` are reached at ratios of 1.4, 0.7 and 0.5."""
RELAXATIONS = (CentralPath(), WIDE, CentralPath(factor=0.3), ScholtesAdaptive())
"""Strategies of successive starts: fast, from the product of characteristic sizes; from ten times this
product; slow; and not on the central path."""
