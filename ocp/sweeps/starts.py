"""Several guesses of one case side by side: the answer is the same whoever solves them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

from ocp.errors import interruptible
from ocp.judgement import judged
from ocp.rollout import initial_guesses
from ocp.routes.homotopy import RouteResult
from ocp.scheduling import Failure, run_jobs
from ocp.session import Session
from ocp.solution import Interrupted, Solution, StageRecord
from ocp.solve import Rank, best_of, check_starts, credited, rank, solve_session
from ocp.sweeps.case import Case
from ocp.sweeps.session_cache import cached_session

_HELD = {"problem", "derivative"}
"""What of a solution holds graphs, which stay where they are."""


@dataclass(frozen=True)
class StartJob:
    """The guess ``number`` of ``starts`` of a case, as :func:`~ocp.rollout.guesses` has them."""

    case: Case
    number: int
    starts: int
    seed: int


@dataclass(frozen=True)
class StartResult:
    """What a solved start sends: its outcome, its NLP's reformulation, and the verdicts."""

    outcome: RouteResult
    judged: dict[str, Any]


def solve_start(job: StartJob, report: Callable[[Any], None]) -> StartResult:
    """Solve from one guess; a :data:`~ocp.scheduling.Function` that tells each stage."""
    session = cached_session(job.case)
    guess = initial_guesses(session.problem, session.values, job.starts, job.seed)[job.number]
    outcome = session.solve(
        progress=lambda stage: report(asdict(stage)), guess=guess, number=job.number
    )
    found = judged(session, outcome, job.seed)
    reformulation = next(key for key, nlp in session.nlps.items() if nlp is outcome.nlp)
    told = {one.name: getattr(found, one.name) for one in fields(found) if one.name not in _HELD}
    return StartResult(replace(outcome, nlp=reformulation), told)


def solve_starts(
    session: Session,
    case: Case,
    starts: int,
    seed: int = 0,
    progress: Callable[[StageRecord], None] | None = None,
    rank_by: Rank = "planned",
    jobs: int = 1,
) -> Solution:
    """Solve from ``starts`` guesses, ``jobs`` of them at a time, each in a process of its own.

    ``session`` is that of ``case`` here. The answer is :func:`~ocp.solve.solve_session`'s, to the
    last bit, and so is what it raises.
    """
    check_starts(starts)
    if jobs == 1 or starts == 1:
        return solve_session(session, starts, seed, progress, rank_by)
    work = [StartJob(case, number, starts, seed) for number in range(starts)]
    found: dict[int, StartResult] = {}

    def callback(_: int, stage: Any) -> None:
        if progress is not None:
            progress(StageRecord(**stage))

    try:
        with (
            interruptible(),
            closing(run_jobs(solve_start, work, jobs, None, callback)) as outcomes,
        ):
            for place, sent in outcomes:
                if isinstance(sent, Failure):
                    raise sent.error
                found[place] = sent
    except KeyboardInterrupt as stop:
        if not found:
            raise
        raise Interrupted(_best(session, found, seed, rank_by)) from stop
    return _best(session, found, seed, rank_by)


def _best(session: Session, found: dict[int, StartResult], seed: int, rank_by: Rank) -> Solution:
    """The best of all, judged again here, where its graphs are."""
    sent = [found[place] for place in sorted(found)]
    made = [Solution(**one.judged, problem=session.problem) for one in sent]
    solutions = credited(session, made)
    place = min(range(len(sent)), key=lambda one: rank(solutions[one], rank_by))
    outcome = sent[place].outcome
    again = judged(session, replace(outcome, nlp=session.nlp_of(outcome.nlp)), seed)
    solutions[place] = replace(solutions[place], derivative=again.derivative)
    return best_of(session, solutions, rank_by)
