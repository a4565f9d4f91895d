"""The one entry: a problem, a law, a method, a policy and a solver in, a judged solution out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from dynamics.contact import ContactLaw
from ocp.errors import InputError, choose, input_errors, interruptible
from ocp.judge.route_report import Attempt
from ocp.problem.policy import Policy
from ocp.problem.problem import Problem
from ocp.problem.resources import check_memory, solve_memory
from ocp.problem.rollout import initial_guesses
from ocp.programs.solver import Solver, Status
from ocp.routes.homotopy import COST_GAIN, StageRecord
from ocp.routes.session import Session, as_swept
from ocp.solution import Interrupted, Solution
from ocp.solve.judging import add_failures, collect_failures, judge_outcome, keep_best_on_interrupt
from ocp.solve.refinement import divided_step, refine_step_size
from ocp.solve.request import ProblemLike, Settings, check_setting_names, rebuilder, resolve_problem
from ocp.solve.warm_start import GuessLike, carried_guess, carry, given_guess
from ocp.transcription import Method
from ocp.transcription.factories import DEFAULT_LAW, make_law, method_of, policy_of, split_policy_settings
from ocp.transcription.nlp import StageCompiler
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


def solve(
    problem: ProblemLike,
    contact: ContactLaw | str = DEFAULT_LAW,
    method: Method | str = "direct",
    policy: Policy | str = "open-loop",
    solver: str = "ipopt",
    settings: Settings | Mapping[str, Any] | None = None,
    n_starts: int = 1,
    seed: int = 0,
    progress: Callable[[StageRecord], None] | None = None,
    warm_start: Solution | None = None,
    rank_by: Rank = "planned",
    *,
    guess: GuessLike | None = None,
    search: bool | None = None,
    refine: bool = False,
    params: Mapping[str, Any] | None = None,
    contact_settings: Mapping[str, Any] | None = None,
    **keywords: Any,
) -> Solution:
    """Solve ``problem``, audit the answer, certify it and have it refereed, as ``ocp solve`` does.

    Problem, law, method and policy are objects or names, with the defaults of the command line::

        solve("push-disc", contact="barrier", mu=1e-3, M=2.0)
        solve(problems.get("push-disc", M=2.0), Barrier(mu=1e-3), Direct(), OpenLoop())

    ``problem`` may also be the path of a file that defines one, or parameters, which editors
    complete: ``solve(push_disc.Params(M=2.0))``. What is named takes its settings
    as ``keywords`` or, with the same name as something else, in ``params`` (of the problem) and
    ``contact_settings`` (of the law). ``settings`` are those of ``-s``: the method's, the solver's,
    and ``policy.<name>``, or an :class:`ocp.Settings`.

    ``n_starts`` > 1 solves from as many guesses, the first the problem's own, the others perturbed
    by seeded noise of 0.3 characteristic units; the best certified answer wins, by its own cost or,
    with ``rank_by``, by what it costs under the ``"exact"`` law or by the ``"referee"``, and the
    others are listed in ``Solution.route.attempts``.

    ``warm_start`` is a solution of the same problem, at other parameters, on another mesh or horizon,
    under another law or by another method: its trajectories and multipliers are what the solver
    starts at (:func:`~ocp.solve.warm_start.carry`). Where it does not converge from there, the usual
    path is followed with those trajectories as the guess.

    ``guess`` is where the solver starts in place of the problem's own guess: two arrays, states
    (N+1, nx) and inputs (N, nu); a dataset with ``x`` and ``u``; or a solution, such as a run that
    :func:`ocp.load` reads, resampled where its horizon differs.

    ``search=True`` finds plans from nothing: pushes where inputs are places of pushers
    (:mod:`ocp.search.push_search`), sampled inputs elsewhere (:mod:`ocp.search.sample_search`); False never. By
    default a scene is searched whose answer has no certificate, does not survive, or hardly beats standing still.

    ``refine`` plans again at half the step, from the last plan, until its cost and that of its
    replay at half the step agree (:func:`~ocp.solve.refinement.refine_step_size`); of a problem object N is
    doubled and all else kept, of a named one it is as with parameters ``N`` and ``h``.

    Raises :class:`~ocp.errors.InputError` for settings, names or combinations that cannot be.
    """
    check_starts(n_starts, seed, rank_by)
    if search and warm_start is not None:
        raise InputError("warm_start and search both say where to begin; give one of them")
    session = new_session(
        problem,
        contact,
        method,
        policy,
        solver,
        settings,
        params=params,
        contact_settings=contact_settings,
        **keywords,
    )
    session.search = search
    if search:
        from ocp.search.push_search import check_search

        check_search(session)
    if guess is not None:
        if warm_start is not None:
            raise InputError("warm_start and guess both say where to begin; give one of them")
        guessed_trajectories = given_guess(guess, session.problem, session.values)
        guessed = replace(session.problem, guess=lambda made, p: guessed_trajectories)
        session = replace(session, problem=guessed)
    if warm_start is not None and n_starts != 1:
        raise InputError("warm_start cannot be combined with several starts; leave n_starts at 1")
    if refine:
        divided_step(session.problem, session.values, 1)
    if warm_start is None:
        solution = solve_session(session, n_starts, seed, progress, rank_by)
    else:
        solution = solve_from(session, warm_start, seed, progress)
    return refine_from(session, solution, rebuilder(problem), seed, progress) if refine else solution


def refine_from(
    session: Session,
    solution: Solution,
    build: Callable[[Problem, dict[str, Any]], Problem],
    seed: int = 0,
    progress: Callable[[StageRecord], None] | None = None,
) -> Solution:
    """Refine a session's solution, see :func:`~ocp.solve.refinement.refine_step_size`.

    ``build`` makes the problem anew, of that one, at other values by name.
    """

    def again(changed_values: dict[str, Any], warm_start: Solution) -> Solution:
        compiled = StageCompiler() if session.compiled else None
        rebuilt = replace(build(session.problem, changed_values), swept=solution.problem.swept)
        finer = replace(session, problem=rebuilt, compiled=compiled)
        values = {**session.values, **changed_values}
        finer.values |= {name: v for name, v in values.items() if name in finer.values}
        return solve_from(finer, warm_start, seed, progress)

    return refine_step_size(solution, again)


def check_starts(n_starts: int, seed: int = 0, rank_by: str = "planned") -> None:
    """Raise :class:`~ocp.errors.InputError` for starts, a seed or a rank that cannot be."""
    if not 1 <= validated("n_starts", n_starts, Count) <= 10_000:
        raise InputError(f"n_starts must be from 1 to 10000, got {n_starts}")
    validated("seed", seed, Index)
    choose("rank", rank_by, dict.fromkeys(get_args(Rank)))


def solve_from(
    session: Session,
    start: Solution,
    seed: int = 0,
    progress: Callable[[StageRecord], None] | None = None,
) -> Solution:
    """Solve a session from a solution; the record says which, and whether it converged so.

    Where it did not, the usual path was followed with its trajectories as the guess. Raises as
    :func:`~ocp.solve.warm_start.carry` does, and :class:`~ocp.solution.Interrupted` with the best point,
    where Ctrl-C ends it.
    """
    if start.route.swept:
        session = as_swept(session)
    with keep_best_on_interrupt(session, seed, progress) as watch:
        outcome = session.resume(carry(start, session.nlp_of("product"), session.values), watch)
        if not (resumed := outcome.finished):
            guess = carried_guess(start, session.problem, session.values)
            cold = session.solve(progress=watch, guess=guess)
            cold.trace.absorb(outcome.trace)
            outcome = cold
        solution = judge_outcome(session, outcome, seed)
    origin = start.run_hash or "a solution in memory"
    return solution.with_route(started_from=origin, resumed=resumed, swept=session.problem.swept)


def new_session(
    problem: ProblemLike,
    contact: ContactLaw | str = DEFAULT_LAW,
    method: Method | str = "direct",
    policy: Policy | str = "open-loop",
    solver: str = "ipopt",
    settings: Settings | Mapping[str, Any] | None = None,
    *,
    params: Mapping[str, Any] | None = None,
    contact_settings: Mapping[str, Any] | None = None,
    **keywords: Any,
) -> Session:
    """Build what a solve, or a whole study, needs once; arguments as :func:`solve` has them.

    Raises :class:`~ocp.errors.InputError` for what cannot be, what would not fit into memory, and
    a setting that would change nothing.
    """
    raw_settings = settings.given() if isinstance(settings, Settings) else settings or {}
    policy_values, own_settings = split_policy_settings(raw_settings)
    built_problem, law_values = resolve_problem(problem, contact, params, contact_settings, keywords, solver)
    transcription_method = method_of(method)
    check_setting_names(own_settings, solver)
    made_policy = policy_of(policy, policy_values)
    law = make_law(contact, law_values, built_problem.system)
    read_settings = Settings.read(own_settings)
    with input_errors():
        needed = solve_memory(built_problem, made_policy, law)
    several = f" and {built_problem.scenarios.n} scenarios" if built_problem.scenarios.n > 1 else ""
    check_memory(f"{built_problem.name} with N = {built_problem.N}{several}", needed)
    session = Session(
        built_problem,
        law,
        transcription_method,
        made_policy,
        Solver(solver, read_settings.options),
        read_settings.strategy,
        read_settings.homotopy,
        read_settings.factor,
        read_settings.homotopy_start,
        compiled=StageCompiler() if read_settings.jit else None,
    )
    _check_use(session, set(own_settings))
    return session


def _check_use(session: Session, given_names: set[str]) -> None:
    """Raise InputError for a setting of ours that this law and method have no use for."""
    follows_path = not session.step.exact and session.schedule() is not None
    useful = {"strategy"} if session.complementary else set()
    if follows_path or (session.step.exact and not session.complementary):
        useful.add("homotopy")
    if follows_path and session.homotopy is not False:
        useful |= {"factor", "homotopy_start"}
    unused = sorted(given_names & {"strategy", "homotopy", "factor", "homotopy_start"} - useful)
    if unused:
        advice = f"; {', '.join(sorted(useful))} would" if useful else ""
        raise InputError(
            f"{' and '.join(unused)} would have no effect for the {session.law.name} law by"
            f" {session.method.name}{advice}; drop {'it' if len(unused) == 1 else 'them'}"
        )
    # Now, so that a path of too many stages is refused before any work.
    _ = session.seconds


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
