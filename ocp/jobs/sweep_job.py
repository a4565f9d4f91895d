"""Points of a sweep, and guesses of one case, as jobs that any process can do."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from ocp.errors import InputError, interruptible
from ocp.jobs.case import Case, cached_session
from ocp.jobs.scheduling import Failure, run_jobs
from ocp.problem.rollout import initial_guesses
from ocp.routes.homotopy import RouteResult, StageRecord
from ocp.routes.session import Session
from ocp.solution import Interrupted, Solution
from ocp.solve.judging import add_failures, collect_failures, judge_outcome
from ocp.solve.solve import Rank, best_of, check_starts, credited, rank, solve_session
from ocp.solve.warm_start import Plan, carry
from ocp.store.provenance import FilesChanged

TRAJECTORIES = ("x", "u", "lam", "gap", "x_replay", "u_replay", "x_referee", "u_referee", "K", "k")
"""What is kept of a solution's arrays, beside the times of nodes."""
REFUSED, FAULT = "refused", "fault"
"""Status of a point that cannot be asked, and of one whose solve raised or whose worker died."""


@dataclass(frozen=True)
class SolveJob:
    """A case, its guesses, and which of the answers is taken; or the ``number`` of one guess.

    With ``start``, what came of a neighbouring point, it is solved from that plan alone.
    """

    case: Case
    starts: int = 1
    seed: int = 0
    rank: Rank = "planned"
    number: int = 0
    start: JobResult | None = None


@dataclass(frozen=True)
class LabelledArray:
    """Values with names of their dimensions, and labels of those whose entries have names."""

    dims: tuple[str, ...]
    values: np.ndarray
    labels: Mapping[str, list[str]]


@dataclass(frozen=True)
class JobResult:
    """What came of a job: numbers and words by name, and arrays by name, none where it failed."""

    row: dict[str, Any]
    arrays: dict[str, LabelledArray]

    def plan(self, session: Session) -> Plan:
        """The trajectories as a start for a session of the same problem."""
        import xarray as xr

        coords = {dim: names for a in self.arrays.values() for dim, names in a.labels.items()}
        arrays = {name: (array.dims, array.values) for name, array in self.arrays.items()}
        record = {"problem": session.problem.name, "method": session.method.name}
        return Plan(xr.Dataset(arrays, coords), record, str(self.row["status"]))


def solve_job(job: SolveJob, report: Callable[[Any], None]) -> JobResult:
    """Solve a point; a :data:`~ocp.jobs.scheduling.Function` that tells each stage's iterations.

    The answer is that of ``ocp solve`` with the same words, whatever the worker did before. What
    cannot be asked, or raises, is a point too, with the sentence as its verdict.

    Raises :class:`~ocp.store.provenance.FilesChanged` where files have changed since the request.
    """
    began = time.perf_counter()
    try:
        with interruptible():
            session = cached_session(job.case)

            def progress(stage: StageRecord) -> None:
                report(stage.iterations)

            if job.start is None:
                found = solve_session(session, job.starts, job.seed, progress, job.rank)
            else:
                point = carry(job.start.plan(session), session.nlp_of("product"), session.values)
                found = judge_outcome(session, session.resume(point, progress), job.seed)
    except FilesChanged:
        raise
    except InputError as error:
        return failed_result(REFUSED, str(error))
    except Exception as error:
        return failed_result(FAULT, f"{type(error).__name__}: {error}")
    return JobResult({**_row(found), "seconds": time.perf_counter() - began}, _arrays(found))


def failed_result(status: str, sentence: str) -> JobResult:
    """A point without an answer, and why."""
    nothing: dict[str, Any] = dict.fromkeys(NUMBERS, float("nan"))
    row = {
        **nothing,
        **dict.fromkeys(WORDS, ""),
        "status": status,
        "grade": "failed",
        "verdict": sentence,
        "success": 0,
        "survives": -1,
        "iterations": 0,
    }
    return JobResult({**row, "seconds": 0.0}, {})


NUMBERS = (
    "cost",
    "exact_cost",
    "referee_cost",
    "refined_cost",
    "idle_cost",
    "complementarity",
    "kkt_residual",
    "dynamics_residual",
    "penetration",
    "solve_s",
    "own_cost",
)
"""What is a number in a row; ``own_cost`` is NaN, but of an outlier its own solve's cost."""
WORDS = ("status", "stationarity", "kind", "grade", "verdict", "start")
"""What is a text there; ``start`` is the point whose plan gave the answer of an outlier."""
COUNTS = ("success", "survives", "iterations")
"""What is whole; success and survives are 1 or 0, and -1 is unknown."""


def _row(found: Solution) -> dict[str, Any]:
    audit, certificate, referee = found.audit, found.certificate, found.referee
    numbers = {
        "cost": found.cost,
        "exact_cost": audit.exact_cost,
        "referee_cost": referee.cost,
        "refined_cost": referee.refined_cost,
        "idle_cost": found.idle_cost,
        "complementarity": audit.complementarity,
        "kkt_residual": certificate.kkt_residual,
        "dynamics_residual": audit.dynamics_residual,
        "penetration": audit.penetration,
        "solve_s": found.solve_s,
        "own_cost": math.nan,
    }
    return {
        **{name: float(value) for name, value in numbers.items()},
        "status": found.status.label,
        "stationarity": certificate.stationarity,
        "kind": certificate.kind,
        "grade": found.grade,
        "verdict": found.verdict,
        "start": "",
        "success": int(found.success),
        "survives": -1 if referee.survives is None else int(referee.survives),
        "iterations": int(found.iterations),
    }


def _arrays(found: Solution) -> dict[str, LabelledArray]:
    data, kept = found.data, {}
    for name in ("time", *TRAJECTORIES):
        if name in data:
            dims = tuple(map(str, data[name].dims))
            named = [dim for dim in dims if dim in data.coords and data[dim].dtype.kind in "UO"]
            labels = {dim: [str(label) for label in data[dim].values] for dim in named}
            kept[name] = LabelledArray(dims, np.asarray(data[name].values, dtype=float), labels)
    return kept


_HELD = {"problem", "derivative"}
"""What of a solution holds graphs, which stay where they are."""


@dataclass(frozen=True)
class StartResult:
    """What a solved start sends: its outcome, its NLP's reformulation, and the verdicts."""

    outcome: RouteResult
    judged: dict[str, Any]


def solve_start(job: SolveJob, report: Callable[[Any], None]) -> StartResult:
    """Solve from one guess; a :data:`~ocp.jobs.scheduling.Function` that tells each stage."""
    session = cached_session(job.case)
    guess = initial_guesses(session.evaluation, job.starts, job.seed)[job.number]
    outcome = session.solve(progress=lambda stage: report(asdict(stage)), guess=guess, number=job.number)
    found = judge_outcome(session, outcome, job.seed)
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
    scheduler: str | None = None,
) -> Solution:
    """Solve from ``starts`` guesses in ``jobs`` processes, or on the cluster of ``scheduler``.

    ``session`` is that of ``case`` here. The answer is :func:`~ocp.solve.solve.solve_session`'s, to the
    last bit, and so is what it raises.
    """
    check_starts(starts, seed, rank_by)
    if starts == 1 or (jobs == 1 and scheduler is None):
        return solve_session(session, starts, seed, progress, rank_by)
    work = [SolveJob(case, starts, seed, number=number) for number in range(starts)]
    found: dict[int, StartResult] = {}
    failures: list[Exception] = []

    def callback(_: int, stage: Any) -> None:
        if progress is not None:
            progress(StageRecord(**stage))

    try:
        with (
            interruptible(),
            closing(run_jobs(solve_start, work, jobs, scheduler, callback)) as outcomes,
        ):
            for place, sent in outcomes:
                if isinstance(sent, Failure):
                    with collect_failures(failures):
                        raise sent.error
                else:
                    found[place] = sent
    except KeyboardInterrupt as stop:
        if not found:
            raise
        raise Interrupted(_best(session, found, seed, rank_by)) from stop
    if not found:
        raise failures[0]
    return add_failures(_best(session, found, seed, rank_by), failures)


def _best(session: Session, found: dict[int, StartResult], seed: int, rank_by: Rank) -> Solution:
    """The best of all, judged again here, where its graphs are."""
    sent = [found[place] for place in sorted(found)]
    made = [Solution(**one.judged, problem=session.problem) for one in sent]
    solutions = credited(session, made)
    place = min(range(len(sent)), key=lambda one: rank(solutions[one], rank_by))
    outcome = sent[place].outcome
    again = judge_outcome(session, replace(outcome, nlp=session.nlp_of(outcome.nlp)), seed)
    solutions[place] = replace(solutions[place], derivative=again.derivative)
    return best_of(session, solutions, rank_by)
