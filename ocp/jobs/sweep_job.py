"""Points of a sweep, and starts of one case, as jobs for any process."""

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
from ocp.jobs.scheduling import THIS_PROCESS, Workers, map_jobs
from ocp.judge.constraints import broken_constraints
from ocp.problem.rollout import Gains, initial_guesses, roll_on
from ocp.routes.homotopy import RouteResult, StageRecord
from ocp.routes.session import Session
from ocp.solution import Interrupted, Solution
from ocp.solve.judging import collect_failures, judge_outcome
from ocp.solve.starts import (
    Rank,
    accept_standing_still,
    best_of,
    best_solution,
    check_starts,
    search_further,
    searches_of,
    solve_session,
)
from ocp.solve.warm_start import StoredPlan, carried_guess, carry
from ocp.store.provenance import FilesChanged

STORED_ARRAYS = ("x", "u", "lam", "gap", "x_replay", "u_replay", "x_referee", "u_referee", "K", "k")
"""Names of a solution's arrays that are stored, beside the times of nodes."""
REJECTED_STATUS = "refused"
"""Status of a point whose request is invalid."""
FAULT_STATUS = "fault"
"""Status of a point whose solve raised or whose worker died."""


@dataclass(frozen=True)
class SolveJob:
    """A case, its guesses, and the rank by which an answer is taken; or the ``number`` of one guess.

    With ``start``, the result of a neighbouring point, it is solved from that plan alone.
    """

    case: Case
    starts: int = 1
    seed: int = 0
    rank: Rank = "planned"
    number: int = 0
    start: JobResult | None = None


@dataclass(frozen=True)
class RollJob:
    """A case, the rank by which an answer is taken, and plans of neighbouring points to roll out there."""

    case: Case
    rank: Rank
    plans: tuple[JobResult, ...]


@dataclass(frozen=True)
class LabelledArray:
    """Values with the names of their dimensions, and labels of dimensions with named entries."""

    dims: tuple[str, ...]
    values: np.ndarray
    labels: Mapping[str, list[str]]


@dataclass(frozen=True)
class JobResult:
    """Result of a job: numbers, texts and arrays by name; no arrays if it failed."""

    row: dict[str, Any]
    arrays: dict[str, LabelledArray]

    def plan(self, session: Session) -> StoredPlan:
        """Return the trajectories as a plan, from which a session of the same problem starts."""
        import xarray as xr

        coords = {dim: names for a in self.arrays.values() for dim, names in a.labels.items()}
        arrays = {name: (array.dims, array.values) for name, array in self.arrays.items()}
        record = {"problem": session.problem.name, "method": session.method.name}
        return StoredPlan(xr.Dataset(arrays, coords), record, str(self.row["status"]))


def solve_job(job: SolveJob, report: Callable[[Any], None]) -> JobResult:
    """Solve a point; a :data:`~ocp.jobs.scheduling.Function` that reports each stage's iterations, None at its end.

    The answer is that of ``ocp solve`` with the same options, whatever the worker did before. A
    request that is invalid, or raises, is a point too, with the message as its verdict.

    Raises :class:`~ocp.store.provenance.FilesChanged` where files have changed since the request.
    """
    point = _solve_point(job, report)
    # Compiled code may have turned Ctrl-C into a failed solve; who hears this may raise it again.
    report(None)
    return point


def _solve_point(job: SolveJob, report: Callable[[Any], None]) -> JobResult:
    start_time = time.perf_counter()
    try:
        with interruptible():
            session = cached_session(job.case)

            def progress(stage: StageRecord) -> None:
                report(stage.iterations)

            if job.start is None:
                solution = solve_session(session, job.starts, job.seed, progress, job.rank)
            else:
                point = carry(job.start.plan(session), session.nlp_of("product"), session.values)
                solution = judge_outcome(session, session.resume(point, progress), job.seed)
    except FilesChanged:
        raise
    except InputError as error:
        return failed_result(REJECTED_STATUS, str(error))
    except Exception as error:
        return failed_result(FAULT_STATUS, f"{type(error).__name__}: {error}")
    return JobResult({**_row_of(solution), "seconds": time.perf_counter() - start_time}, _labelled_arrays(solution))


def plan_costs(job: RollJob, report: Callable[[Any], None]) -> list[float]:
    """Return the cost of each plan at a job's parameters; a :data:`~ocp.jobs.scheduling.Function`.

    The law is that by whose costs answers are ranked. NaN where a step is not solved, or a constraint is violated.
    """
    session = cached_session(job.case)
    problem, evaluation, costs = session.problem, session.evaluation, list[float]()
    step = {"exact": problem.exact_step, "referee": problem.referee_step}.get(job.rank, session.step)
    for point in job.plans:
        plan = point.plan(session)
        x, u = carried_guess(plan, problem, session.values)
        inputs = Gains(plan.data["K"].values, plan.data["k"].values) if "K" in plan.data else u[None]
        rolled, unsolved = roll_on(evaluation, inputs, step, None if problem.start is None else x[:1])
        is_plan = unsolved is None and not broken_constraints(evaluation, rolled)
        costs.append(rolled.cost if is_plan else math.nan)
        report(None)
    return costs


def failed_result(status: str, sentence: str) -> JobResult:
    """Return a point without an answer, with the reason."""
    no_numbers: dict[str, Any] = dict.fromkeys(ROW_NUMBERS, float("nan"))
    row = {
        **no_numbers,
        **dict.fromkeys(ROW_TEXTS, ""),
        "status": status,
        "grade": "failed",
        "verdict": sentence,
        "success": 0,
        "survives": -1,
        "iterations": 0,
        "outlier": 0,
    }
    return JobResult({**row, "seconds": 0.0}, {})


ROW_NUMBERS: dict[str, Callable[[Solution], float]] = {
    "cost": lambda solution: solution.cost,
    "exact_cost": lambda solution: solution.audit.exact_cost,
    "referee_cost": lambda solution: solution.referee.cost,
    "refined_cost": lambda solution: solution.referee.refined_cost,
    "idle_cost": lambda solution: solution.idle_cost,
    "complementarity": lambda solution: solution.audit.complementarity,
    "kkt_residual": lambda solution: solution.certificate.kkt_residual,
    "dynamics_residual": lambda solution: solution.audit.dynamics_residual,
    "penetration": lambda solution: solution.audit.penetration,
    "solve_s": lambda solution: solution.solve_s,
    "own_cost": lambda _: math.nan,
    "neighbour_cost": lambda _: math.nan,
}
"""Numbers of a row, NaN without an answer; of outliers alone ``own_cost`` is the cost of the own solve, where a
neighbour's plan gave a better answer, and ``neighbour_cost`` that of a neighbour's plan, where it is still better."""
ROW_TEXTS: dict[str, Callable[[Solution], str]] = {
    "status": lambda solution: solution.status.label,
    "stationarity": lambda solution: solution.certificate.stationarity,
    "kind": lambda solution: solution.certificate.kind,
    "grade": lambda solution: solution.grade,
    "verdict": lambda solution: solution.verdict,
    "start": lambda _: "",
}
"""Texts of a row; ``start`` is the point whose plan gave the answer of an outlier."""
ROW_COUNTS: dict[str, Callable[[Solution], int]] = {
    "success": lambda solution: solution.success,
    "survives": lambda solution: -1 if solution.referee.survives is None else solution.referee.survives,
    "iterations": lambda solution: solution.iterations,
    "outlier": lambda _: 0,
}
"""Integers of a row; success and survives are 1 or 0, and -1 if unknown; outlier is 1 where a neighbour's plan is
better than every answer."""


def _row_of(solution: Solution) -> dict[str, Any]:
    return {
        **{name: float(number(solution)) for name, number in ROW_NUMBERS.items()},
        **{name: text(solution) for name, text in ROW_TEXTS.items()},
        **{name: int(count(solution)) for name, count in ROW_COUNTS.items()},
    }


def _labelled_arrays(solution: Solution) -> dict[str, LabelledArray]:
    data, arrays = solution.data, {}
    for name in ("time", *STORED_ARRAYS):
        if name in data:
            dims = tuple(map(str, data[name].dims))
            labelled_dims = [dim for dim in dims if dim in data.coords and data[dim].dtype.kind in "UO"]
            labels = {dim: [str(label) for label in data[dim].values] for dim in labelled_dims}
            arrays[name] = LabelledArray(dims, np.asarray(data[name].values, dtype=float), labels)
    return arrays


GRAPH_FIELDS = {"problem", "derivative"}
"""Fields of a solution that hold graphs and are not sent."""


@dataclass(frozen=True)
class StartResult:
    """Result of a solved start: its outcome, with its NLP's reformulation, and the verdicts."""

    outcome: RouteResult
    judged: dict[str, Any]


def solve_start(job: SolveJob, report: Callable[[Any], None]) -> StartResult:
    """Solve from one guess; a :data:`~ocp.jobs.scheduling.Function` that tells each stage."""
    session = cached_session(job.case)
    guess = initial_guesses(session.evaluation, job.starts, job.seed)[job.number]
    outcome = session.solve(progress=lambda stage: report(asdict(stage)), guess=guess, number=job.number)
    solution = judge_outcome(session, outcome, job.seed)
    reformulation = next(key for key, nlp in session.nlps.items() if nlp is outcome.nlp)
    judgement = {
        field_of.name: getattr(solution, field_of.name)
        for field_of in fields(solution)
        if field_of.name not in GRAPH_FIELDS
    }
    return StartResult(replace(outcome, nlp=reformulation), judgement)


def solve_starts(
    session: Session,
    case: Case,
    starts: int,
    seed: int = 0,
    progress: Callable[[StageRecord], None] | None = None,
    rank_by: Rank = "planned",
    workers: Workers = THIS_PROCESS,
) -> Solution:
    """Solve from ``starts`` guesses side by side.

    ``session`` is the session of ``case`` in this process. The solution is the same as that of
    :func:`~ocp.solve.starts.solve_session`, to the last bit, and so are the errors raised.
    """
    check_starts(starts, seed, rank_by)
    if starts == 1 or workers.serial:
        return solve_session(session, starts, seed, progress, rank_by)
    work = {number: SolveJob(case, starts, seed, number=number) for number in range(starts)}
    finished: dict[int, StartResult] = {}
    failures: list[Exception] = []

    def callback(_: int, stage: Any) -> None:
        if progress is not None:
            progress(StageRecord(**stage))

    def note_failure(_: int, error: Exception) -> None:
        with collect_failures(failures):
            raise error

    try:
        with closing(map_jobs(solve_start, work, workers, None, callback, note_failure)) as results:
            # Those that end before Ctrl-C stay.
            finished.update((number, result) for number, result in results if result is not None)
    except KeyboardInterrupt as stop:
        if not finished:
            raise
        solutions = _solutions_of(session, finished, seed, rank_by)
        raise Interrupted(best_of(session, solutions, rank_by)) from stop
    if not finished:
        raise failures[0]
    solutions = _solutions_of(session, finished, seed, rank_by)
    return search_further(session, solutions, failures, searches_of(session, seed, progress), rank_by)


def _solutions_of(session: Session, finished: dict[int, StartResult], seed: int, rank_by: Rank) -> list[Solution]:
    """Return the solutions of all starts, the best judged again in this process, which has its graphs."""
    results = [finished[place] for place in sorted(finished)]
    solutions_of_starts = [Solution(**start.judged, problem=session.problem) for start in results]
    solutions = accept_standing_still(session, solutions_of_starts)
    place = next(i for i, best in enumerate(solutions) if best is best_solution(solutions, rank_by))
    outcome = results[place].outcome
    judged_here = judge_outcome(session, replace(outcome, nlp=session.nlp_of(outcome.nlp)), seed)
    solutions[place] = replace(solutions[place], derivative=judged_here.derivative)
    return solutions
