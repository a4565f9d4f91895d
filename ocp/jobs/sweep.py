"""Parallel solves over a grid, saved as they end; the verdict on all points."""

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
from ocp.jobs.case import Case
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
from ocp.solve.starts import Rank, check_starts
from ocp.store.checkpoint import UNSAVED, SavedWork
from ocp.store.provenance import FilesChanged
from ocp.transcription.factories import DEFAULT_LAW, law_name
from ocp.validation import Axis, expand_path

if TYPE_CHECKING:
    import xarray as xr


OnPoint = Callable[[int, JobResult], None]
"""Called with the index of a point in the grid, the last axis fastest, and its result."""


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

    ``over`` are values by name, arrays or words such as ``"0.5:2:7"`` and ``"1e-4:1e-1:4:log"``: of
    a parameter of the problem (``M``, also ``N``), a setting of the law (``contact.mu``), a number
    of the settings (``setting.tol``) or of the policy (``policy.bound``). Everything else is as for
    :func:`ocp.solve`; a problem goes by its name or its file, for other processes build it too.

    ``jobs`` processes of this computer work side by side, or with ``scheduler``, such as
    ``tcp://127.0.0.1:8786``, a Dask cluster; answers do not depend on them. Each point's answer is
    that of a solve of its own, to the last bit, unless a neighbour's plan is better there: such
    outliers have the neighbour in ``start`` and the cost of their own solve in ``own_cost``. Where
    a neighbour's plan is better, and no solve from it is, ``outlier`` is 1, and ``neighbour_cost``
    what that plan costs there. A
    point whose worker was killed is begun again. With ``store``, a directory, finished points are
    kept there until all are, and the same call goes on after a stop.

    Returns a dataset with a dimension an axis and, at each point, ``cost exact_cost referee_cost
    survives status stationarity iterations seconds verdict`` and more, and the trajectories ``x u
    lam gap``, their replays, and ``time``. A point that failed has its verdict and NaN.

    Raises :class:`~ocp.errors.InputError` for requests that no point can satisfy.
    """
    name = _problem_name(problem)
    problem_params, law_settings = split_keywords(
        Case(name).source(), contact, params, contact_settings, keywords, solver
    )
    law = law_name(contact)
    law_settings = law_settings if isinstance(contact, str) else contact.settings()
    case = Case(name, problem_params, law, law_settings, method, policy, solver, dict(settings or {}))
    study = make_grid(case, parse_axes(over), n_starts, seed, rank_by)
    session = study.check(jobs)
    root = None if store is None else expand_path(store)
    with study.checkpoint(root, session.problem.name) as checkpoint:
        finished = load_points(study, checkpoint)
        points = solve_grid(study, Workers(jobs, scheduler), checkpoint, finished, progress or (lambda *_: None))
        checkpoint.discard()
    return grid_dataset(study, session, points)


def _problem_name(problem: ProblemLike) -> str:
    """Return the name of a problem, or the absolute path of its file, for any process."""
    if isinstance(problem, Problem):
        raise InputError(
            f"{problem.name} is built already, and a sweep builds it at every point, in other"
            " processes too; give its name, or the path of its file"
        )
    if not isinstance(problem, str | PathLike):
        return str(getattr(problem, "path", None) or problem.name)
    path = fspath(problem)
    return str(expand_path(path).resolve()) if path.endswith(".py") else path


def make_grid(case: Case, over: tuple[Axis, ...], starts: int = 1, seed: int = 0, rank_by: Rank = "planned") -> Grid:
    """Return the grid of a case, its axes by their full names.

    Raises :class:`~ocp.errors.InputError` for a name that is unknown, repeated or set otherwise.
    """
    check_starts(starts, seed, rank_by)
    source = case.source()
    case = case.with_content(source)
    full_axes = [replace(axis, name=case.full_name(axis.name, source)) for axis in over]
    names = [axis.name for axis in full_axes]
    for axis, name in zip(over, names, strict=True):
        if names.count(name) > 1:
            raise InputError(f"--over: {name} is given twice; give it once")
        if case.sets(name):
            raise InputError(f"{axis.name} is swept by --over; drop its own value")
    return Grid(case, tuple(full_axes), starts, seed, rank_by)


def solve_grid(
    study: Grid,
    workers: Workers = THIS_PROCESS,
    files: SavedWork = UNSAVED,
    finished: dict[int, JobResult] | None = None,
    on_point: OnPoint = lambda *_: None,
    callback: Callable[[int, Any], None] = lambda *_: None,
) -> list[JobResult]:
    """Solve all points of a study that are not ``finished``, and add them to it; return all points.

    Then, pass by pass, points are solved from neighbours' plans that cost less
    (:class:`~ocp.jobs.neighbours.Exchange`), and the better answer is taken: a pass starts from the
    results of the one before, so that neither the order nor the number of workers matters.

    Each solved point is saved in ``files`` and passed to ``on_point``. A point's reports,
    and None at its end, go to ``callback``, which may raise to stop.

    Raises :class:`~ocp.store.provenance.FilesChanged` where files have changed since the request.
    """
    finished, places = {} if finished is None else finished, study.places

    def solve_jobs(jobs: Mapping[int, SolveJob], first: int) -> Generator[tuple[int, JobResult], None, None]:
        # Points of one structure are neighbours, since a worker builds each structure once.
        ordered = {place: jobs[place] for place in sorted(jobs, key=lambda place: study.shape_of(places[place]))}
        saved = SavedPoints(files, first)
        with closing(map_jobs(solve_job, ordered, workers, saved, callback, _fault)) as points_of_jobs:
            yield from points_of_jobs

    unsolved = {place: study.job(values) for place, values in enumerate(places) if place not in finished}
    with closing(solve_jobs(unsolved, 0)) as solved_points:
        for place, point in solved_points:
            finished[place] = point
            on_point(place, point)

    def roll_plans(jobs: Mapping[int, RollJob]) -> Generator[tuple[int, list[float]], None, None]:
        with closing(map_jobs(plan_costs, jobs, workers, None, callback, partial(_no_costs, jobs))) as costs_of_jobs:
            yield from costs_of_jobs

    points = [finished[place] for place in range(len(places))]
    return neighbours.Exchange(study, points, solve_jobs, roll_plans).run()


def _fault(_: int, error: Exception) -> JobResult:
    """Return the point of a job that failed; it is not saved, as the next try may succeed."""
    if isinstance(error, FilesChanged):
        raise error
    return failed_result(FAULT_STATUS, str(error))


def _no_costs(jobs: Mapping[int, RollJob], place: int, error: Exception) -> list[float]:
    """Return the costs of plans that could not be rolled out."""
    _fault(place, error)
    return [math.nan] * len(jobs[place].plans)
