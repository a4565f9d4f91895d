"""Entry point of a solve: from a problem, a law, a method, a policy and a solver to a judged solution."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from dynamics.contact import ContactLaw
from ocp.errors import InputError, choose, input_errors
from ocp.problem.policy import Policy
from ocp.problem.problem import Problem
from ocp.problem.resources import check_memory, solve_memory
from ocp.programs.solver import Point, Solver
from ocp.routes.homotopy import StageRecord
from ocp.routes.session import DEFAULT_EFFORT, Effort, Session
from ocp.solution import Solution
from ocp.solve.guesses import GuessLike, user_guess_of
from ocp.solve.judging import judge_outcome, keep_best_on_interrupt
from ocp.solve.refinement import divided_step, refine_step_size
from ocp.solve.request import ProblemLike, Settings, check_setting_names, rebuilder, resolve_problem
from ocp.solve.starts import Rank, can_exceed_route, check_starts, check_until, is_greater, read_effort, solve_session
from ocp.solve.warm_start import carried_guess, carry
from ocp.transcription import METHODS, Method
from ocp.transcription.factories import DEFAULT_LAW, make_law, policy_of, split_policy_settings
from ocp.transcription.nlp import StageCompiler


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
    effort: Effort | float = DEFAULT_EFFORT,
    refine: bool = False,
    until: str | None = None,
    params: Mapping[str, Any] | None = None,
    contact_settings: Mapping[str, Any] | None = None,
    **keywords: Any,
) -> Solution:
    """Solve ``problem`` and judge the result by audit, certificate and referee, as ``ocp solve`` does.

    Problem, law, method and policy are objects or names, with the defaults of the command line::

        solve("push-disc", contact="barrier", mu=1e-3, M=2.0)
        solve(problems.get("push-disc", M=2.0), Barrier(mu=1e-3), Direct(), OpenLoop())

    ``problem`` may also be the path of a file, or parameters, which editors complete: ``push_disc.Params(M=2.0)``.
    A named problem or law takes its settings as ``keywords``, or in ``params`` (of the problem) and
    ``contact_settings`` (of the law) if both have the name. ``settings`` are those of ``-s``: the method's, the
    solver's, and ``policy.<name>``, or an :class:`ocp.Settings`.

    ``n_starts`` > 1 solves from as many guesses: first the problem's guess, then guesses perturbed by seeded noise of
    0.3 characteristic units; the best certified solution is returned, by its own cost or, with ``rank_by``, by its cost
    when replayed under the ``"exact"`` law or by the ``"referee"``. ``Solution.route.attempts`` lists all
    attempts.

    ``warm_start`` is a solution of the same problem, at other parameters, on another mesh or horizon, under another
    law or by another method; the solver starts from its trajectories and multipliers
    (:func:`~ocp.solve.warm_start.carry`). If it does not converge, they are the guess of a usual solve.
    ``guess`` replaces the problem's own guess: states (N+1, nx) and inputs (N, nu); a dataset with ``x`` and ``u``;
    or a solution, such as a run that :func:`ocp.load` reads, resampled if its horizon differs. Under the exact
    law the guess is also rolled out and improved locally: the solution is never worse than this rollout. A run of
    another problem gives the states and inputs with the same names. A :class:`~ocp.problem.sketch.Sketch`, or its
    keyframes ``{0: pose, 20: pose}`` alone, specifies only some states of a plan and the times at
    which contacts close; under the exact law the solver finds such plans, and then improves them without these limits.

    ``effort`` says what is tried beyond the usual route under the exact law: ``"quick"`` nothing, unless a scene's
    answer falls short; ``"normal"`` sampled input sequences, while their costs approach the answer's, changes of the
    best answer, and other routes where the answer idles or has no certificate; ``"thorough"`` samples under two laws
    and all routes (:mod:`ocp.search`). A number is the normal effort with samples of about so many steps.
    ``search=True`` begins with the thorough search for plans; ``search=False`` allows no search.
    ``refine`` solves again at half the step, from the last plan, until the cost of the plan agrees with the cost of its
    replay at half the step (:func:`~ocp.solve.refinement.refine_step_size`).
    ``until="survives"`` tries remedies while the plan does not survive the referee: the referee's own contact, finer
    steps, gains along the plan, gains over scenarios, a controller (:class:`~ocp.solve.ladder.SurvivalLadder`). The
    first answer that survives is returned, gains over scenarios in its place if it survives few draws of friction or
    masses and they survive more, or else the best; ``Solution.route.ladder`` has all of them.

    Raises :class:`~ocp.errors.InputError` for invalid settings, names or combinations.
    """
    check_starts(n_starts, seed, rank_by)
    _check_beginnings(search, warm_start, guess, n_starts)
    if warm_start is not None and is_greater(effort):
        raise InputError(f"effort {effort} would have no effect with warm_start; leave one of them out")
    named_settings = {"params": params, "contact_settings": contact_settings, **keywords}
    session = new_session(problem, contact, method, policy, solver, settings, **named_settings)
    session = begin_at(session, guess, search, effort)
    if refine:
        divided_step(session.problem, session.values, 1)
    check_until(until, session)
    if warm_start is None:
        solution = solve_session(session, n_starts, seed, progress, rank_by)
    else:
        solution = solve_from(session, warm_start, seed, progress)
    if refine:
        solution = refine_from(session, solution, rebuilder(problem), seed, progress)
    return solution if until is None else climb_from(session, solution, rebuilder(problem), seed, progress)


def _check_beginnings(search: bool | None, warm_start: Solution | None, guess: GuessLike | None, n_starts: int) -> None:
    """Raise :class:`~ocp.errors.InputError` if another argument conflicts with ``warm_start``."""
    for name, exclusive in (("search", search), ("guess", guess is not None)):
        if exclusive and warm_start is not None:
            raise InputError(f"warm_start and {name} both say where to begin; give one of them")
    if warm_start is not None and n_starts != 1:
        raise InputError("warm_start cannot be combined with several starts; leave n_starts at 1")


def begin_at(
    session: Session, guess: GuessLike | None, search: bool | None, effort: Effort | float = DEFAULT_EFFORT
) -> Session:
    """Return the session with a user's guess, choice of search, and effort; raise InputError if they conflict."""
    session.search, (session.effort, session.rollout_steps) = search, read_effort(effort)
    if is_greater(effort) and (search is False or not can_exceed_route(session)):
        raise InputError(
            f"effort {effort} would have no effect: it searches under the exact law, by the direct method and without"
            " --no-search; leave it out"
        )
    if search:
        from ocp.search.push_search import check_search

        check_search(session)
    if guess is None:
        return session
    user_guess = user_guess_of(guess, session.problem, session.values)
    if "gap" in user_guess.windows and (search is False or not session.complementary):
        raise InputError("contacts of a guess need the exact law, direct transcription and a search")
    problem = replace(session.problem, guess=lambda made, p: user_guess.trajectories)
    return session.with_changes(problem=problem, user_guess=user_guess)


def refine_from(
    session: Session,
    solution: Solution,
    build: Callable[[Problem, dict[str, Any]], Problem],
    seed: int = 0,
    progress: Callable[[StageRecord], None] | None = None,
) -> Solution:
    """Refine a session's solution, see :func:`~ocp.solve.refinement.refine_step_size`.

    ``build`` rebuilds a problem with other parameter values, a dict from name to value.
    """

    def again(changed_values: dict[str, Any], warm_start: Solution) -> Solution:
        rebuilt = replace(build(session.problem, changed_values), swept=solution.problem.swept)
        return solve_from(session.with_changes(changed_values, problem=rebuilt), warm_start, seed, progress)

    return refine_step_size(solution, again)


def climb_from(
    session: Session,
    solution: Solution,
    build: Callable[[Problem, dict[str, Any]], Problem],
    seed: int = 0,
    progress: Callable[[StageRecord], None] | None = None,
) -> Solution:
    """Try remedies until a session's solution survives, see :class:`~ocp.solve.ladder.SurvivalLadder`."""
    # Imported only here, so that other solves do not load policies and the controller.
    from ocp.solve.ladder import SurvivalLadder

    if solution.problem is not session.problem:  # The solution has been refined.
        session = session.with_changes(solution.values, problem=solution.problem)
    return SurvivalLadder(session, solution, build, solve_from, seed, progress).climb()


def solve_from(
    session: Session, start: Solution, seed: int = 0, progress: Callable[[StageRecord], None] | None = None
) -> Solution:
    """Solve a session from the solution ``start``; the route records its hash and whether the solver converged.

    If the solver did not converge, the trajectories of ``start`` are the guess of a usual solve. Raises as
    :func:`~ocp.solve.warm_start.carry` does, and :class:`~ocp.solution.Interrupted` with the best point
    if Ctrl-C ends the solve.
    """
    if start.route.swept:
        session = session.as_swept()
    with keep_best_on_interrupt(session, seed, progress) as watch:
        point = carry(start, session.nlp_of("product"), session.values)
        if session.complementary and len(start.arrays["time"]) != session.problem.N + 1:
            # Multipliers of pairs on another mesh mislead: those of a contact's events are at single nodes.
            point = Point(point.x)
        outcome = session.resume(point, watch)
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
    """Return the session of a solve, or of a whole study; the arguments are those of :func:`solve`.

    Raises :class:`~ocp.errors.InputError` for invalid arguments, for a problem that does not fit into memory, and for
    a setting without effect.
    """
    raw_settings = settings.changed() if isinstance(settings, Settings) else settings or {}
    policy_values, own_settings = split_policy_settings(raw_settings)
    built_problem, law_values = resolve_problem(problem, contact, params, contact_settings, keywords, solver)
    transcription_method = choose("method", method, METHODS)() if isinstance(method, str) else method
    check_setting_names(own_settings, solver)
    made_policy = policy_of(policy, policy_values)
    law = make_law(contact, law_values, built_problem.system)
    read_settings = Settings.read(own_settings)
    with input_errors():
        needed_bytes = solve_memory(built_problem, made_policy, law)
    several = f" and {built_problem.scenarios.n} scenarios" if built_problem.scenarios.n > 1 else ""
    check_memory(f"{built_problem.name} with N = {built_problem.N}{several}", needed_bytes)
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
    """Raise InputError for a setting that has no effect under the session's law and method."""
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
    # Raises an error before any work if the path has too many stages.
    _ = session.seconds
