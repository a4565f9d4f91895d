"""Solutions from one or several guesses and from searches, and the choice of the best solution."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from dynamics.limits import INDEX, STARTS
from dynamics.settings import read_value
from ocp.errors import InputError, choose, interruptible
from ocp.judge.route_report import Attempt, SearchReport
from ocp.problem.rollout import initial_guesses
from ocp.programs.solver import Status
from ocp.routes.homotopy import COST_GAIN, StageRecord
from ocp.routes.session import DEFAULT_EFFORT, Effort, Session
from ocp.solution import Interrupted, Solution
from ocp.solve.judging import add_failures, collect_failures, judge_outcome, keep_best_on_interrupt
from ocp.validation import Number, validated

if TYPE_CHECKING:
    from ocp.search.search import Search

Rank = Literal["planned", "exact", "referee"]
"""Cost by which solutions are ranked: under the law, replayed under the exact law, or replayed by the referee."""
UNTIL = {"survives": "try remedies until the plan survives the referee, at h and at h/4"}
"""Values of ``until`` with their meaning."""
WAYS = 4
"""Number of guesses that are solved before standing still is accepted as the best solution."""
MAX_EFFORT = 1_000_000_000
"""Largest number of steps to roll out; the samples of a round are in memory at once."""
CERTIFIED_SHARE = 0.01
"""Relative excess cost below which a certified solution is preferred to a cheaper one without a certificate."""
SURVIVING_SHARE = 0.002
"""Relative excess cost up to which a solution that survives the referee is preferred to a cheaper one that fails."""
_FEASIBLE = {Status.SOLVED: 0, Status.NOT_OPTIMAL: 0, Status.UNDECIDED: 0, Status.NO_PROGRESS: 1}
"""Mapping from each status of a feasible solution to its rank; lower is better."""


def check_starts(n_starts: int, seed: int = 0, rank_by: str = "planned") -> None:
    """Raise :class:`~ocp.errors.InputError` for an invalid number of starts, seed or rank."""
    read_value("n_starts", n_starts, int, **STARTS)
    read_value("seed", seed, int, **INDEX)
    choose("rank", rank_by, dict.fromkeys(get_args(Rank)))


def read_effort(effort: Effort | float) -> tuple[Effort, int | None]:
    """Split an effort into its level and its number of steps to roll out.

    A number implies the level normal; a level alone has no number (None).

    Raises :class:`~ocp.errors.InputError` for another word, and for a number that is not whole, or not from 1 to
    :data:`MAX_EFFORT`.
    """
    if isinstance(effort, str):
        levels: dict[str, Effort] = {level: level for level in get_args(Effort)}
        return choose("effort", effort, levels), None
    number = validated("effort", effort, Number)
    if not (1 <= number <= MAX_EFFORT and number.is_integer()):
        raise InputError(f"effort must be a level, or a whole number of steps from 1 to {MAX_EFFORT}, got {number:g}")
    return DEFAULT_EFFORT, int(number)


def is_greater(effort: Effort | float) -> bool:
    """Return whether an effort exceeds the normal effort: it is ``"thorough"`` or a number of steps."""
    return effort not in ("quick", DEFAULT_EFFORT)


def check_until(until: str | None, session: Session) -> None:
    """Raise :class:`~ocp.errors.InputError` for an unknown ``until``, or if the system has no referee."""
    if until is None:
        return
    choose("until", until, UNTIL)
    if session.problem.system.referee_note is None:
        raise InputError(f"until survives needs a referee, and {session.problem.name} has no geometry; leave it out")


def solve_session(
    session: Session,
    n_starts: int = 1,
    seed: int = 0,
    progress: Callable[[StageRecord], None] | None = None,
    rank_by: Rank = "planned",
) -> Solution:
    """Return the best solution of a session, from one or several guesses and from searches.

    If a search over pushes is requested, or the scene has many corners, the solutions of this search replace those
    from the guesses. Otherwise the search follows the guesses, if their solution falls short
    (:meth:`ocp.search.push_search.PushSearch.is_needed`).

    Raises :class:`~ocp.solution.Interrupted` if Ctrl-C ends the solve, with the best solution so far or,
    during the first start, with the best point so far.
    """
    solutions: list[Solution] = []
    failures: list[Exception] = []
    searches = searches_of(session, seed, progress)
    guesses = initial_guesses(session.evaluation, WAYS if n_starts == 1 else n_starts, seed)
    try:
        with interruptible():
            for search in searches:
                with collect_failures(failures):
                    solutions += search.replacements()
            for number, guess in enumerate(guesses if not solutions else ()):
                stands_still = solutions and session.follows_smoothing and _stands_still(solutions[-1])
                if number >= n_starts and not stands_still:
                    break
                interruptible_start = keep_best_on_interrupt(session, seed, progress)
                watching = nullcontext(progress) if solutions else interruptible_start
                with collect_failures(failures), watching as watch:
                    outcome = session.solve(progress=watch, guess=guess, number=number)
                    solutions.append(judge_outcome(session, outcome, seed))
                    solutions += _replays(session, solutions[-1], seed)
    except KeyboardInterrupt as stop:
        if not solutions:
            raise
        raise Interrupted(best_of(session, solutions, rank_by)) from stop
    return search_further(session, solutions, failures, searches, rank_by)


def search_further(
    session: Session, solutions: list[Solution], failures: list[Exception], searches: list[Search], rank_by: Rank
) -> Solution:
    """Return the best of ``solutions`` and of further solutions from searches; raise the first failure if none.

    Raises :class:`~ocp.solution.Interrupted` with the best solution so far if Ctrl-C ends a search.
    """
    if not solutions:
        raise failures[0]
    try:
        with interruptible():
            for search in searches:
                best = best_solution(solutions, rank_by)
                if search.is_needed(best):
                    with collect_failures(failures):
                        solutions += search.solutions(best)
    except KeyboardInterrupt as stop:
        raise Interrupted(best_of(session, solutions, rank_by)) from stop
    best = solutions[0] if len(solutions) == 1 else best_of(session, solutions, rank_by)
    report = SearchReport.joined([search.report for search in searches if search.report is not None])
    return add_failures(best.with_route(search=report), failures)


def _replays(session: Session, solution: Solution, seed: int) -> list[Solution]:
    """Return :func:`~ocp.search.plan_solver.replay_of_inputs` of a solution that fails at its own step."""
    if not solution.fails_at_its_step:
        return []
    # Imported here, so that other problems do not load what only searches need.
    from ocp.search.plan_solver import replay_of_inputs

    return replay_of_inputs(session, solution, judge_outcome, seed)


def can_exceed_route(session: Session) -> bool:
    """Return whether searches can improve on the usual route: its NLP must contain the exact law without branches."""
    return session.complementary and session.step.branches == 1


def searches_of(session: Session, seed: int, progress: Callable[[StageRecord], None] | None) -> list[Search]:
    """Return the searches to run after the usual route, in order."""
    pushing = bool(session.problem.system.scene)
    eager = session.effort != "quick" and can_exceed_route(session)
    if session.search is False or not (session.search or eager or pushing or session.user_guess is not None):
        return []
    # Imported here, so that other problems do not load what only searches need.
    from ocp.search.other_routes import GuessSearch, RouteSearch
    from ocp.search.sample_search import NearSearch, SampleSearch

    searches: list[Search] = []
    thorough, sampled = session.effort == "thorough", bool(session.search)
    if session.user_guess is not None:
        searches.append(GuessSearch(session, judge_outcome, seed, progress, guess=session.user_guess))
    if pushing:
        from ocp.search.push_search import PushSearch
        from ocp.search.push_tree import searchable

        sampled = sampled and not searchable(session.problem)
        if not sampled:
            searches.append(PushSearch(session, judge_outcome, seed, progress))
    if eager or sampled:
        searches.append(SampleSearch(session, judge_outcome, seed, progress, thorough or sampled))
    if eager:
        searches.append(RouteSearch(session, judge_outcome, seed, progress, thorough))
        searches.append(NearSearch(session, judge_outcome, seed, progress, thorough))
    return searches


def _stands_still(solution: Solution) -> bool:
    return solution.status is Status.NO_PROGRESS and solution.certificate.certified


def best_of(session: Session, solutions: list[Solution], rank_by: Rank = "planned") -> Solution:
    """Return the best solution, with a list of all attempts and the sum of their iterations and seconds.

    Standing still counts as solved if :func:`accept_standing_still` accepts it.
    """
    solutions = accept_standing_still(session, solutions)
    best = best_solution(solutions, rank_by)
    attempts = [
        Attempt(
            start=index,
            status=attempt.status.label,
            cost=attempt.cost,
            exact_cost=attempt.audit.exact_cost,
            referee_cost=attempt.referee.cost,
            iterations=attempt.iterations,
            chosen=attempt is best,
            route=attempt.route.name,
            seconds=attempt.solve_s,
        )
        for index, attempt in enumerate(solutions)
    ]
    iterations = sum(solution.iterations for solution in solutions)
    total_seconds = {key: sum(getattr(solution, key) for solution in solutions) for key in ("solve_s", "evaluation_s")}
    return replace(best, iterations=iterations, **total_seconds).with_route(attempts=attempts)


def accept_standing_still(session: Session, solutions: list[Solution]) -> list[Solution]:
    """Return the solutions, with status SOLVED for standing still if that is the best solution.

    Standing still is the best solution if it is certified, costs no more than any feasible solution, and several
    solves that follow a smoothing ended certified; ``route.idle_attempts`` counts these solves.
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


def best_solution(solutions: Sequence[Solution], by: Rank = "planned") -> Solution:
    """Return the best solution: the feasible solution with the lowest cost, with the cost defined by ``by``.

    Under the exact law the planned cost is the cost of the exact replay. Among costs that differ by less than
    :data:`CERTIFIED_SHARE` a certified solution is preferred. Among these, or without a certified one among all
    solutions, costs that differ by at most :data:`SURVIVING_SHARE` are equal, and a solution that survives the referee,
    at h and at h/4, is preferred. In a scene, solutions that survive the referee at the plan's step size precede all
    others.
    """
    best_order = min(map(_order_of_end, solutions))
    feasible = [solution for solution in solutions if _order_of_end(solution) == best_order]
    costs = {id(solution): _cost_by(solution, by) for solution in feasible}

    def cost_of(solution: Solution) -> float:
        return costs[id(solution)]

    def near_cheapest(candidates: Sequence[Solution], share: float) -> list[Solution]:
        cheapest = min(candidates, key=cost_of)
        least_cost = cost_of(cheapest)
        return [s for s in candidates if s is cheapest or s.cost_share(cost_of(s) - least_cost, least_cost) <= share]

    certified = [s for s in near_cheapest(feasible, CERTIFIED_SHARE) if s.certificate.certified]
    equal = near_cheapest(certified or feasible, SURVIVING_SHARE)
    return min(equal, key=lambda s: (s.referee.survives is not True, cost_of(s)))


def _order_of_end(solution: Solution) -> int:
    """Return the rank of a solution: 0 feasible, 1 standing still, 2 other; plus 3 in a scene if it fails at h."""
    return _FEASIBLE.get(solution.status, 2) + 3 * solution.fails_at_its_step


def _cost_by(solution: Solution, by: Rank) -> float:
    """Return the cost by which solutions are compared, infinite in place of NaN."""
    planned = solution.audit.exact_cost if solution.record["contact"] == "exact" else solution.cost
    cost = {"planned": planned, "exact": solution.audit.exact_cost, "referee": solution.referee.cost}[by]
    return cost if np.isfinite(cost) else np.inf
