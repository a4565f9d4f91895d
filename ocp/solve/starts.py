"""Solutions from one or several guesses and from a search, and the best of them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from ocp.errors import InputError, choose, interruptible
from ocp.judge.route_report import Attempt
from ocp.problem.rollout import initial_guesses
from ocp.programs.solver import Status
from ocp.routes.homotopy import COST_GAIN, StageRecord
from ocp.routes.session import Session
from ocp.solution import Interrupted, Solution
from ocp.solve.judging import add_failures, collect_failures, judge_outcome, keep_best_on_interrupt
from ocp.validation import Count, Index, validated

if TYPE_CHECKING:
    from ocp.search.push_search import PushSearch
    from ocp.search.sample_search import SampleSearch

Rank = Literal["planned", "exact", "referee"]
"""Order of several answers: their cost under the law, replayed under the exact one, or by the
referee."""
WAYS = 4
"""Ways to try before standing still is called the best, each by a guess of its own."""
_FEASIBLE = {Status.SOLVED: 0, Status.NOT_OPTIMAL: 1, Status.UNDECIDED: 1, Status.NO_PROGRESS: 2}
"""Ends that are feasible, and their order."""


def check_starts(n_starts: int, seed: int = 0, rank_by: str = "planned") -> None:
    """Raise :class:`~ocp.errors.InputError` for starts, a seed or a rank that cannot be."""
    if not 1 <= validated("n_starts", n_starts, Count) <= 10_000:
        raise InputError(f"n_starts must be from 1 to 10000, got {n_starts}")
    validated("seed", seed, Index)
    choose("rank", rank_by, dict.fromkeys(get_args(Rank)))


def solve_session(
    session: Session,
    n_starts: int = 1,
    seed: int = 0,
    progress: Callable[[StageRecord], None] | None = None,
    rank_by: Rank = "planned",
) -> Solution:
    """Solve a session from one or several guesses.

    A search over pushes replaces these where it is chosen, or the scene has many corners, and it
    finds anything; it comes after them where their answer falls short
    (:meth:`ocp.search.push_search.PushSearch.wanted`).

    Raises :class:`~ocp.solution.Interrupted`, with the best answer so far, or in the first start
    with the best point so far, where Ctrl-C ends it.
    """
    solutions: list[Solution] = []
    failures: list[Exception] = []
    search = _searcher(session, seed, progress)
    n_guesses = WAYS if n_starts == 1 else n_starts
    guesses = initial_guesses(session.evaluation, n_guesses, seed)
    try:
        with interruptible():
            if search is not None and search.first:
                with collect_failures(failures):
                    solutions += search.solutions()
            for number, guess in enumerate(guesses if not solutions else ()):
                stands_still = solutions and session.follows_smoothing and _stands_still(solutions[-1])
                if number >= n_starts and not stands_still:
                    break
                interruptible_start = keep_best_on_interrupt(session, seed, progress)
                watching = nullcontext(progress) if solutions else interruptible_start
                with collect_failures(failures), watching as watch:
                    outcome = session.solve(progress=watch, guess=guess, number=number)
                    solutions.append(judge_outcome(session, outcome, seed))
            if not solutions:
                raise failures[0]
            best = min(solutions, key=lambda solution: rank(solution, rank_by))
            if search is not None and not search.first and search.wanted(best):
                with collect_failures(failures):
                    solutions += search.solutions(best)
    except KeyboardInterrupt as stop:
        if not solutions:
            raise
        raise Interrupted(best_of(session, solutions, rank_by)) from stop
    best = solutions[0] if len(solutions) == 1 else best_of(session, solutions, rank_by)
    return add_failures(best.with_route(search=None if search is None else search.report), failures)


def _searcher(
    session: Session, seed: int, progress: Callable[[StageRecord], None] | None
) -> PushSearch | SampleSearch | None:
    """Return the search over pushes where the problem has pushers, over sampled inputs where it is chosen."""
    if session.search is False or not (session.search or session.problem.system.scene):
        return None
    # Only here: what only searches need is not loaded for other problems.
    from ocp.search.push_search import PushSearch
    from ocp.search.push_tree import searchable
    from ocp.search.sample_search import SampleSearch

    if session.search and not searchable(session.problem):
        return SampleSearch(session, judge_outcome, seed, progress)
    return PushSearch(session, judge_outcome, seed, progress)


def _stands_still(solution: Solution) -> bool:
    return solution.status is Status.NO_PROGRESS and solution.certificate.certified


def best_of(session: Session, solutions: list[Solution], rank_by: Rank = "planned") -> Solution:
    """Return the best certified answer, with the others listed and the work of all counted.

    To stand still counts as one where it may, see :func:`accept_standing_still`.
    """
    solutions = accept_standing_still(session, solutions)
    best = min(solutions, key=lambda solution: rank(solution, rank_by))
    attempts = [
        Attempt(
            start=index,
            status=attempt.status.label,
            cost=attempt.cost,
            exact_cost=attempt.audit.exact_cost,
            referee_cost=attempt.referee.cost,
            iterations=attempt.iterations,
            chosen=attempt is best,
        )
        for index, attempt in enumerate(solutions)
    ]
    iterations = sum(solution.iterations for solution in solutions)
    total_seconds = {key: sum(getattr(solution, key) for solution in solutions) for key in ("solve_s", "evaluation_s")}
    return replace(best, iterations=iterations, **total_seconds).with_route(attempts=attempts)


def accept_standing_still(session: Session, solutions: list[Solution]) -> list[Solution]:
    """The solutions, of which those that rightly stand still count as solved.

    That is certified, costs no more than any feasible end, and is what was found by several ways
    that feel contact from afar. ``route.idle_attempts`` counts those with a certified end.
    """
    certified_solutions = [
        solution for solution in solutions if solution.status in _FEASIBLE and solution.certificate.certified
    ]
    lowest_cost = min((solution.cost for solution in solutions if solution.status in _FEASIBLE), default=np.inf)
    if len(certified_solutions) < 2 or not session.follows_smoothing:
        return solutions
    cost_share = partial(session.evaluation.cost_share, cost=lowest_cost)
    return [
        replace(solution, status=Status.SOLVED).with_route(idle_attempts=len(certified_solutions))
        if _stands_still(solution) and not cost_share(solution.cost - lowest_cost) > COST_GAIN
        else solution
        for solution in solutions
    ]


def rank(solution: Solution, by: Rank = "planned") -> tuple[int, float]:
    """Order answers: certified ones first, then the others that are feasible, then by cost.

    Of a scene, answers that survive the referee come before all others.
    """
    costs = {"planned": solution.cost, "exact": solution.audit.exact_cost, "referee": solution.referee.cost}
    cost = costs[by]
    fails_referee = solution.referee.survives_at_h is False and solution.problem.system.scene
    return _FEASIBLE.get(solution.status, 3) + 4 * fails_referee, cost if np.isfinite(cost) else np.inf
