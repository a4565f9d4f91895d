"""Many solves over a grid: side by side, kept as they end, the same whoever does them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from dataclasses import replace
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dynamics.contact import ContactLaw
from ocp.effort import check_memory, points_memory
from ocp.errors import InputError, interruptible
from ocp.problem import Problem
from ocp.request import ProblemLike, split_keywords
from ocp.scheduling import Failure, run_jobs
from ocp.session import Session
from ocp.solve import Rank, check_starts
from ocp.store.checkpoint import Checkpoint
from ocp.sweeps.case import Case, FilesChanged
from ocp.sweeps.grid import Grid, axes, dataset, save_point, saved_points
from ocp.sweeps.job import FAULT, JobResult, failed_result, solve_job
from ocp.validation import Axis, expand_path

if TYPE_CHECKING:
    import xarray as xr

OnPoint = Callable[[int, JobResult], None]
"""Called with the place of a point in the grid, the last axis fastest, and what came of it."""


def sweep(
    problem: ProblemLike,
    over: Mapping[str, Any] | Iterable[str | Axis],
    contact: ContactLaw | str = "barrier",
    *,
    params: Mapping[str, Any] | None = None,
    contact_settings: Mapping[str, Any] | None = None,
    method: str = "direct",
    policy: str = "open-loop",
    solver: str = "ipopt",
    settings: Mapping[str, Any] | None = None,
    starts: int = 1,
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
    ``tcp://127.0.0.1:8786``, a Dask cluster. Each point's answer is that of a solve of its own, to
    the last bit: it depends neither on them nor on the other points. A point whose worker was
    killed is begun again. With ``store``, a directory, finished points are kept there until all
    are, and the same call goes on after a stop.

    Returns a dataset with a dimension an axis and, at each point, ``cost exact_cost referee_cost
    survives status stationarity iterations seconds verdict`` and more, and the trajectories ``x u
    lam gap``, their replays, and ``time``. A point that failed has its verdict and NaN.

    Raises :class:`~ocp.errors.InputError` for what no point could be solved with.
    """
    name = _name(problem)
    own, given = split_keywords(
        Case(name).source(), contact, params, contact_settings, keywords, solver
    )
    law = contact if isinstance(contact, str) else contact.name
    given = given if isinstance(contact, str) else contact.settings()
    case = Case(name, own, law, given, method, policy, solver, dict(settings or {}))
    study = make_grid(case, axes(over), starts, seed, rank_by)
    session = study.check()
    check_parallel_memory(session, jobs)
    check_points(study, session)
    root = None if store is None else expand_path(store)
    with study.checkpoint(root, session.problem.name) as checkpoint:
        found = saved_points(study, checkpoint)
        points = solve_grid(
            study, jobs, scheduler, checkpoint, found, progress or (lambda *_: None)
        )
        checkpoint.discard()
    return dataset(study, session, points)


def _name(problem: ProblemLike) -> str:
    """What any process finds a problem by: its name, or the whole path of its file."""
    if isinstance(problem, Problem):
        raise InputError(
            f"{problem.name} is built already, and a sweep builds it at every point, in other"
            " processes too; give its name, or the path of its file"
        )
    if not isinstance(problem, str | PathLike):
        return str(getattr(problem, "path", None) or problem.name)
    named = fspath(problem)
    return str(expand_path(named).resolve()) if named.endswith(".py") else named


def make_grid(
    case: Case, over: tuple[Axis, ...], starts: int = 1, seed: int = 0, rank_by: Rank = "planned"
) -> Grid:
    """A study of a case, its axes called by their full names.

    Raises :class:`~ocp.errors.InputError` for a name that is unknown, twice or given otherwise.
    """
    check_starts(starts)
    source = case.source()
    case = case.with_content(source)
    full = [replace(axis, name=case.full_name(axis.name, source)) for axis in over]
    names = [axis.name for axis in full]
    for axis, name in zip(over, names, strict=True):
        if names.count(name) > 1:
            raise InputError(f"--over: {name} is given twice; give it once")
        if case.sets(name):
            raise InputError(f"{axis.name} is swept by --over; drop its own value")
    return Grid(case, tuple(full), starts, seed, rank_by)


def check_parallel_memory(session: Session, jobs: int) -> None:
    """Raise :class:`~ocp.errors.InputError` where so many solves at once need too much memory."""
    check_memory(f"{jobs} solves in parallel", jobs * session.memory)


def check_points(study: Grid, session: Session) -> None:
    """Raise :class:`~ocp.errors.InputError` where all points together need too much memory."""
    count = math.prod(study.shape)
    # Shorter points are filled up to the longest.
    longest = math.prod(
        max(axis.values) / axis.values[0] for axis in study.axes
        if axis.name in ("problem.N", "problem.scenarios")
    )  # fmt: skip
    check_memory(f"a grid of {count} points", points_memory(session.problem, count, longest))


def solve_grid(
    study: Grid,
    jobs: int = 1,
    scheduler: str | None = None,
    checkpoint: Checkpoint | None = None,
    found: dict[int, JobResult] | None = None,
    on_point: OnPoint = lambda *_: None,
    callback: Callable[[int, Any], None] = lambda *_: None,
) -> list[JobResult]:
    """All points of a study: those of ``found`` as they are, the others solved and added to it.

    Each that is solved is written to the checkpoint and passed to ``on_point``. What a point
    reports, and None at its end, goes to ``callback``, which may raise to stop.

    Raises :class:`~ocp.sweeps.case.FilesChanged` where files have changed since the request.
    """
    places, found = study.places, {} if found is None else found
    # Points of one structure stand together, for a worker builds each structure once.
    left = sorted((place for place in range(len(places)) if place not in found),
                  key=lambda place: study.shape_of(places[place]))  # fmt: skip
    work = [study.job(places[place]) for place in left]

    def told(index: int, message: Any) -> None:
        callback(left[index], message)

    with interruptible(), closing(run_jobs(solve_job, work, jobs, scheduler, told)) as outcomes:
        for index, outcome in outcomes:
            # Compiled code may have made a failed solve of Ctrl-C.
            told(index, None)
            place = left[index]
            if isinstance(outcome, Failure):
                if isinstance(outcome.error, FilesChanged):
                    raise outcome.error
                # Not kept: what a worker died of may be gone at the next try.
                point = failed_result(FAULT, str(outcome.error))
            else:
                point = outcome
                if checkpoint is not None:
                    save_point(checkpoint, place, point)
            found[place] = point
            on_point(place, point)
    return [found[place] for place in range(len(places))]
