"""Jobs that any process can run: a point of a sweep, or a solve from one of several initial guesses."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from ocp.errors import InputError, interruptible
from ocp.jobs.scheduling import THIS_PROCESS, Workers, map_jobs
from ocp.jobs.session_cache import cached_session
from ocp.judge.constraints import broken_constraints
from ocp.labelled import LabelledArrays
from ocp.problem.rollout import Gains, initial_guesses, roll_on
from ocp.routes.homotopy import RouteResult, StageRecord
from ocp.routes.session import Session
from ocp.solution import Interrupted, Solution
from ocp.solve.judging import collect_failures, judge_outcome
from ocp.solve.solve_request import SolveRequest
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
"""Names of a solution's arrays that are stored, in addition to the times of nodes."""
REJECTED_STATUS = "refused"
"""Status of a point that was not solved because its parameters or settings are invalid."""
FAULT_STATUS = "fault"
"""Status of a point whose solve raised or whose worker died."""


@dataclass(frozen=True)
class SolveJob:
    """Job that solves a request from ``starts`` guesses and takes the best solution by ``rank``.

    If ``start`` is the result of a neighbouring point, the request is solved only from the plan of that result.
    """

    request: SolveRequest
    starts: int = 1
    seed: int = 0
    rank: Rank = "planned"
    start: JobResult | None = None


@dataclass(frozen=True)
class StartJob:
    """Job that solves a request from the guess with index ``number`` of ``starts`` guesses."""

    request: SolveRequest
    starts: int
    seed: int
    number: int


@dataclass(frozen=True)
class RollJob:
    """Job that rolls out ``plans`` of neighbouring points at the parameters of a request.

    ``rank`` is the ranking of the sweep, which determines the contact law of the rollouts.
    """

    request: SolveRequest
    rank: Rank
    plans: tuple[JobResult, ...]


@dataclass(frozen=True)
class LabelledArray:
    """Array with named dimensions ``dims``; ``labels`` maps dimensions with labels to the names of their entries."""

    dims: tuple[str, ...]
    values: np.ndarray
    labels: Mapping[str, list[str]]


@dataclass(frozen=True)
class JobResult:
    """Result of a job: numbers and texts in ``row``, and labelled arrays; without arrays if the job failed."""

    row: dict[str, Any]
    arrays: dict[str, LabelledArray]

    def plan(self, session: Session) -> StoredPlan:
        """Return the trajectories as a plan from which a session of the same problem can start."""
        coords = {dim: names for a in self.arrays.values() for dim, names in a.labels.items()}
        arrays = {name: (array.dims, array.values) for name, array in self.arrays.items()}
        record = {"problem": session.problem.name, "method": session.method.name}
        return StoredPlan(LabelledArrays(arrays, coords), record, str(self.row["status"]))


def solve_job(job: SolveJob, report: Callable[[Any], None]) -> JobResult:
    """Solve a point of a sweep; report the iterations of each stage, and None at the end.

    The solution is the same as that of ``ocp solve`` with the same options, whatever jobs the worker has run
    before. If the request is invalid, or the solve raises an error, the result's verdict is the error message.

    Raises :class:`~ocp.store.provenance.FilesChanged` if files have changed since the request.
    """
    point = _solve_point(job, report)
    # Compiled code may have turned Ctrl-C into a failed solve; this report allows the receiver to raise it again.
    report(None)
    return point


def _solve_point(job: SolveJob, report: Callable[[Any], None]) -> JobResult:
    start_time = time.perf_counter()
    try:
        with interruptible():
            session = cached_session(job.request)

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
    """Return the cost of each of the job's plans, rolled out at the parameters of the job's request.

    The contact law is the law by whose cost solutions are ranked. The cost is NaN if a step is not solved or a
    constraint is violated.
    """
    session = cached_session(job.request)
    problem, evaluation, costs = session.problem, session.evaluation, list[float]()
    step = {"exact": problem.exact_step, "referee": problem.referee_step}.get(job.rank, session.step)
    for point in job.plans:
        plan = point.plan(session)
        x, u = carried_guess(plan, problem, session.values)
        inputs = Gains(plan.arrays["K"], plan.arrays["k"]) if "K" in plan.arrays else u[None]
        rolled, unsolved = roll_on(evaluation, inputs, step, None if problem.start is None else x[:1])
        is_plan = unsolved is None and not broken_constraints(evaluation, rolled)
        costs.append(rolled.cost if is_plan else math.nan)
        report(None)
    return costs


def failed_result(status: str, sentence: str) -> JobResult:
    """Return the result of a point without a solution; ``sentence`` gives the reason."""
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
"""Mapping from names of a row's numbers to functions of a solution; numbers are NaN without a solution.

``own_cost`` and ``neighbour_cost`` are set only for outliers: the cost of the point's separate solve if the
solution started from a neighbour's plan, and the cost of a neighbour's plan if it is lower than the cost of the
solution."""
ROW_TEXTS: dict[str, Callable[[Solution], str]] = {
    "status": lambda solution: solution.status.label,
    "stationarity": lambda solution: solution.certificate.stationarity,
    "kind": lambda solution: solution.certificate.kind,
    "grade": lambda solution: solution.grade,
    "verdict": lambda solution: solution.verdict,
    "start": lambda _: "",
}
"""Mapping from names of a row's texts to functions of a solution; ``start`` is set later, to the neighbour used."""
ROW_COUNTS: dict[str, Callable[[Solution], int]] = {
    "success": lambda solution: solution.success,
    "survives": lambda solution: -1 if solution.referee.survives is None else solution.referee.survives,
    "iterations": lambda solution: solution.iterations,
    "outlier": lambda _: 0,
}
"""Mapping from names of a row's integers to functions of a solution.

``success`` and ``survives`` are 1 or 0, or -1 if unknown; ``outlier`` is 1 if a neighbour's plan is better."""


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
"""Names of a solution's fields that contain CasADi graphs and are not sent between processes."""


@dataclass(frozen=True)
class StartResult:
    """Result of a solve from one guess: the outcome, the name of its NLP, and fields of the judged solution."""

    outcome: RouteResult
    judged: dict[str, Any]


def solve_start(job: StartJob, report: Callable[[Any], None]) -> StartResult:
    """Solve a request from one of its guesses, and report each stage of the solve."""
    session = cached_session(job.request)
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
    request: SolveRequest,
    starts: int,
    seed: int = 0,
    progress: Callable[[StageRecord], None] | None = None,
    rank_by: Rank = "planned",
    workers: Workers = THIS_PROCESS,
) -> Solution:
    """Solve a request from ``starts`` guesses in parallel and return the best solution.

    ``session`` is the session of ``request`` in this process. The solution is bitwise the same as that of
    :func:`~ocp.solve.starts.solve_session`, which solves serially; errors are also the same.
    """
    check_starts(starts, seed, rank_by)
    if starts == 1 or workers.serial:
        return solve_session(session, starts, seed, progress, rank_by)
    work = {number: StartJob(request, starts, seed, number) for number in range(starts)}
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
            # Results from before a Ctrl-C are kept.
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
    """Return the solutions of all starts; the best is judged again, since its graphs are in this process."""
    results = [finished[number] for number in sorted(finished)]
    solutions_of_starts = [Solution(**start.judged, problem=session.problem) for start in results]
    solutions = accept_standing_still(session, solutions_of_starts)
    best_index = next(i for i, solution in enumerate(solutions) if solution is best_solution(solutions, rank_by))
    outcome = results[best_index].outcome
    judged_here = judge_outcome(session, replace(outcome, nlp=session.nlp_of(outcome.nlp)), seed)
    solutions[best_index] = replace(solutions[best_index], derivative=judged_here.derivative)
    return solutions
