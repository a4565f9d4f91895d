"""Parameter sweeps: parallel solves at the points of a grid, which are saved as they end."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import closing
from dataclasses import replace
from functools import partial
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynamics.contact import ContactLaw
from ocp.errors import InputError
from ocp.jobs import neighbours
from ocp.jobs.grid import Grid, SavedPoints, grid_dataset, load_points, parse_axes
from ocp.jobs.scheduling import THIS_PROCESS, Workers, map_jobs
from ocp.jobs.sweep_job import (
    FAULT_STATUS,
    JobResult,
    RollJob,
    SolveJob,
    failed_result,
    plan_costs,
    solve_job,
)
from ocp.problem.problem import Problem
from ocp.solve.request import ProblemLike, split_keywords
from ocp.solve.solve_request import SolveRequest
from ocp.solve.starts import Rank, check_starts
from ocp.store.checkpoint import UNSAVED, SavedWork
from ocp.store.provenance import FilesChanged
from ocp.transcription.factories import DEFAULT_LAW, law_name
from ocp.validation import Axis, expand_path

if TYPE_CHECKING:
    import xarray as xr


OnPoint = Callable[[int, JobResult], None]
"""Callback with the index of a point in the grid (the last axis varies fastest) and the point's result."""


def sweep(
    problem: ProblemLike,
    over: Mapping[str, Any] | Iterable[str | Axis],
    contact: ContactLaw | str = DEFAULT_LAW,
    *,
    params: Mapping[str, Any] | None = None,
    contact_settings: Mapping[str, Any] | None = None,
    method: str = "direct",
    policy: str = "open-loop",
    solver: str = "ipopt",
    settings: Mapping[str, Any] | None = None,
    n_starts: int = 1,
    rank_by: Rank = "planned",
    seed: int = 0,
    jobs: int = 1,
    scheduler: str | None = None,
    store: Path | str | None = None,
    progress: OnPoint | None = None,
    **keywords: Any,
) -> xr.Dataset:
    """Solve a problem at every point of a grid, as ``ocp sweep`` does::

        sweep("push-disc", {"M": [0.5, 1, 2], "contact.mu": "1e-4:1e-1:4:log"}, N=20, jobs=2)

    ``over`` maps names to arrays or texts such as ``"0.5:2:7"`` and ``"1e-4:1e-1:4:log"``. A name is a
    parameter of the problem (``M``, also ``N``), a setting of the law (``contact.mu``), a numeric setting of
    the method or solver (``setting.tol``), or a setting of the policy (``policy.bound``). Other arguments are
    those of :func:`ocp.solve`, but the problem must be a name or a file, from which other processes can build it.
    Points are solved in parallel by ``jobs`` processes on this computer or, if ``scheduler`` is an address such
    as ``tcp://127.0.0.1:8786``, on a Dask cluster; solutions are the same in all cases.

    Each solution is bitwise the same as that of a separate solve, unless a solve that starts from the plan of a
    neighbouring point gives a better one. Then ``start`` is the neighbour, and ``own_cost`` the cost of the
    separate solve. If a neighbour's plan is better at a point but no solve from this plan is better, ``outlier`` is 1
    and ``neighbour_cost`` is the cost of that plan at the point. A point whose worker was killed is started
    again. If ``store`` is a directory, finished points are stored there until all points are finished, and the
    same call resumes after an interruption.

    Return a dataset with a dimension for each axis and, at each point, ``cost exact_cost referee_cost survives status
    stationarity iterations seconds verdict`` and others, the trajectories ``x u lam gap``, their replays, and
    ``time``. At a failed point, ``verdict`` gives the reason and numbers are NaN.

    Raises :class:`~ocp.errors.InputError` for requests that no point can satisfy.
    """
    name = _problem_name(problem)
    problem_params, law_settings = split_keywords(
        SolveRequest(name).source(), contact, params, contact_settings, keywords, solver
    )
    law = law_name(contact)
    law_settings = law_settings if isinstance(contact, str) else contact.settings()
    request = SolveRequest(name, problem_params, law, law_settings, method, policy, solver, dict(settings or {}))
    study = make_grid(request, parse_axes(over), n_starts, seed, rank_by)
    session = study.check(jobs)
    root = None if store is None else expand_path(store)
    with study.checkpoint(root, session.problem.name) as checkpoint:
        finished = load_points(study, checkpoint)
        points = solve_grid(study, Workers(jobs, scheduler), checkpoint, finished, progress or (lambda *_: None))
        checkpoint.discard()
    return grid_dataset(study, session, points)


def _problem_name(problem: ProblemLike) -> str:
    """Return the problem's name, or the absolute path of its file, from which any process can build it."""
    if isinstance(problem, Problem):
        raise InputError(
            f"{problem.name} is built already, and a sweep builds it at every point, in other"
            " processes too; give its name, or the path of its file"
        )
    if not isinstance(problem, str | PathLike):
        return str(getattr(problem, "path", None) or problem.name)
    path = fspath(problem)
    return str(expand_path(path).resolve()) if path.endswith(".py") else path


def make_grid(
    request: SolveRequest, over: tuple[Axis, ...], starts: int = 1, seed: int = 0, rank_by: Rank = "planned"
) -> Grid:
    """Return the grid of a request over the axes ``over``, with names replaced by full names.

    Raises :class:`~ocp.errors.InputError` for a name that is unknown, repeated or also set in the request.
    """
    check_starts(starts, seed, rank_by)
    source = request.source()
    request = request.with_content(source)
    full_axes = [replace(axis, name=request.full_name(axis.name, source)) for axis in over]
    names = [axis.name for axis in full_axes]
    for axis, name in zip(over, names, strict=True):
        if names.count(name) > 1:
            raise InputError(f"--over: {name} is given twice; give it once")
        if request.sets(name):
            raise InputError(f"{axis.name} is swept by --over; drop its own value")
    return Grid(request, tuple(full_axes), starts, seed, rank_by)


def solve_grid(
    study: Grid,
    workers: Workers = THIS_PROCESS,
    files: SavedWork = UNSAVED,
    finished: dict[int, JobResult] | None = None,
    on_point: OnPoint = lambda *_: None,
    callback: Callable[[int, Any], None] = lambda *_: None,
) -> list[JobResult]:
    """Solve all points of a grid that are not in ``finished``, and add them to it; return all points.

    Points are then solved again, in passes, from neighbours' plans that cost less
    (:class:`~ocp.jobs.neighbours.Exchange`), and the better solution is taken. Each pass starts from the
    results of the previous pass, so that results do not depend on the order or the number of workers.
    ``on_point`` is called after the first solve of each point, and all results are saved in ``files``.
    ``callback`` is called with each report of a job, and with None at the job's end; it may raise an exception
    to stop.

    Raises :class:`~ocp.store.provenance.FilesChanged` if files have changed since the request.
    """
    finished, values = {} if finished is None else finished, study.point_values

    def solve_jobs(jobs: Mapping[int, SolveJob], first: int) -> Generator[tuple[int, JobResult], None, None]:
        # Points of the same structure are solved in succession, since a worker reuses the last structure.
        ordered = {index: jobs[index] for index in sorted(jobs, key=lambda index: study.structure_key(values[index]))}
        saved = SavedPoints(files, first)
        with closing(map_jobs(solve_job, ordered, workers, saved, callback, _fault)) as points_of_jobs:
            yield from points_of_jobs

    unsolved = {index: study.job(point) for index, point in enumerate(values) if index not in finished}
    with closing(solve_jobs(unsolved, 0)) as solved_points:
        for index, point in solved_points:
            finished[index] = point
            on_point(index, point)

    def roll_plans(jobs: Mapping[int, RollJob]) -> Generator[tuple[int, list[float]], None, None]:
        with closing(map_jobs(plan_costs, jobs, workers, None, callback, partial(_no_costs, jobs))) as costs_of_jobs:
            yield from costs_of_jobs

    points = [finished[index] for index in range(len(values))]
    return neighbours.Exchange(study, points, solve_jobs, roll_plans).run()


def _fault(_: int, error: Exception) -> JobResult:
    """Return the result of a point whose job failed; it is not saved, since another attempt may succeed."""
    if isinstance(error, FilesChanged):
        raise error
    return failed_result(FAULT_STATUS, str(error))


def _no_costs(jobs: Mapping[int, RollJob], index: int, error: Exception) -> list[float]:
    """Return NaN as the cost of each plan of a job that failed."""
    _fault(index, error)
    return [math.nan] * len(jobs[index].plans)
