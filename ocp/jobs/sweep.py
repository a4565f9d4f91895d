"""Many solves over a grid, side by side and kept as they end; what they come to, in words."""

from __future__ import annotations

import itertools
import math
import shlex
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from dataclasses import replace
from functools import partial
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.contact import ContactLaw
from ocp.errors import InputError, interruptible
from ocp.jobs import neighbours
from ocp.jobs.case import Case
from ocp.jobs.grid import Grid, axes, dataset, dimension, save_point, saved_point, saved_points
from ocp.jobs.scheduling import Failure, run_jobs
from ocp.jobs.sweep_job import COUNTS, FAULT, NUMBERS, WORDS, JobResult, SolveJob, failed_result, solve_job
from ocp.problem.problem import Problem
from ocp.problem.resources import check_memory, points_memory
from ocp.routes.session import Session
from ocp.solve.judging import session_record
from ocp.solve.request import ProblemLike, split_keywords
from ocp.solve.solve import Rank, check_starts
from ocp.store.checkpoint import Checkpoint
from ocp.store.provenance import FilesChanged
from ocp.transcription.factories import DEFAULT_LAW, law_name
from ocp.validation import Axis, expand_path

if TYPE_CHECKING:
    import xarray as xr


OnPoint = Callable[[int, JobResult], None]
"""Called with the place of a point in the grid, the last axis fastest, and what came of it."""


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
    outliers have the neighbour in ``start`` and the cost of their own solve in ``own_cost``. A
    point whose worker was killed is begun again. With ``store``, a directory, finished points are
    kept there until all are, and the same call goes on after a stop.

    Returns a dataset with a dimension an axis and, at each point, ``cost exact_cost referee_cost
    survives status stationarity iterations seconds verdict`` and more, and the trajectories ``x u
    lam gap``, their replays, and ``time``. A point that failed has its verdict and NaN.

    Raises :class:`~ocp.errors.InputError` for what no point could be solved with.
    """
    name = _name(problem)
    own, given = split_keywords(Case(name).source(), contact, params, contact_settings, keywords, solver)
    law = law_name(contact)
    given = given if isinstance(contact, str) else contact.settings()
    case = Case(name, own, law, given, method, policy, solver, dict(settings or {}))
    study = make_grid(case, axes(over), n_starts, seed, rank_by)
    session = study.check()
    check_parallel_memory(session, jobs)
    check_points(study, session)
    root = None if store is None else expand_path(store)
    with study.checkpoint(root, session.problem.name) as checkpoint:
        found = saved_points(study, checkpoint)
        points = solve_grid(study, jobs, scheduler, checkpoint, found, progress or (lambda *_: None))
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


def make_grid(case: Case, over: tuple[Axis, ...], starts: int = 1, seed: int = 0, rank_by: Rank = "planned") -> Grid:
    """A study of a case, its axes called by their full names.

    Raises :class:`~ocp.errors.InputError` for a name that is unknown, twice or given otherwise.
    """
    check_starts(starts, seed, rank_by)
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
        max(axis.values) / axis.values[0] for axis in study.axes if axis.name in ("problem.N", "problem.scenarios")
    )
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

    Then, pass by pass, each point is solved from its cheapest neighbour's plan where that costs
    less, and the better answer is taken: a pass starts at what the one before it came to, so that
    neither order nor number of workers counts.

    Each that is solved is written to the checkpoint and passed to ``on_point``. What a point
    reports, and None at its end, goes to ``callback``, which may raise to stop.

    Raises :class:`~ocp.store.provenance.FilesChanged` where files have changed since the request.
    """
    found = {} if found is None else found
    jobs_of = {place: study.job(values) for place, values in enumerate(study.places)}
    run = partial(_solve_jobs, study, jobs, scheduler, checkpoint, callback=callback)
    run(jobs_of, 0, found, on_point)
    points = [found[place] for place in range(len(jobs_of))]
    changed = set(range(len(points)))
    for number in range(1, sum(study.shape)):
        starts = neighbours.starts(study, points, changed)
        warm = {k: study.job(study.places[k], points[near]) for k, near in starts.items()}
        tried: dict[int, JobResult] = {}
        run(warm, number * len(points), tried, lambda *_: None)
        better = {k for k in tried if neighbours.improves(study, tried[k].row, points[k].row)}
        names = [dimension(axis.name) for axis in study.axes]
        for k in better:
            near = dict(zip(names, study.places[starts[k]].values(), strict=True))
            points[k] = neighbours.outlier(tried[k], points[k], where(near, names))
        changed = better
        if not changed:
            break
    return points


def _solve_jobs(
    study: Grid,
    jobs: int,
    scheduler: str | None,
    checkpoint: Checkpoint | None,
    jobs_of: Mapping[int, SolveJob],
    first: int,
    found: dict[int, JobResult],
    on_point: OnPoint,
    callback: Callable[[int, Any], None],
) -> None:
    """Add to ``found`` what comes of the jobs by place; they are kept from number ``first`` on."""
    for place in jobs_of:
        kept = saved_point(checkpoint, first + place) if checkpoint and first else None
        if kept is not None:
            found[place] = kept
    places = study.places
    # Points of one structure stand together, for a worker builds each structure once.
    left = sorted((place for place in jobs_of if place not in found), key=lambda place: study.shape_of(places[place]))
    work = [jobs_of[place] for place in left]

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
                    save_point(checkpoint, first + place, point)
            found[place] = point
            on_point(place, point)


KIND = "sweep"
"""Kind of a stored run."""


def run_meta(study: Grid, session: Session, data: xr.Dataset) -> dict[str, Any]:
    """What a run's description has of a study, but for ``argv`` and where the problem is from."""
    found, dims = rows(data), [dimension(axis.name) for axis in study.axes]
    solved = sum(row["success"] for row in found)
    failures = [
        {
            "at": {dim: row[dim] for dim in dims},
            "status": row["status"],
            "verdict": row["verdict"],
            "command": shlex.join(study.job(place).case.command(study.seed, study.starts, study.rank)),
        }
        for place, row in zip(study.places, found, strict=True)
        if not row["success"]
    ]
    axes = [
        {
            "name": dim,
            "full_name": axis.name,
            "values": list(axis.values),
            "log": axis.log,
            "units": data[dim].attrs["units"],
        }
        for dim, axis in zip(dims, study.axes, strict=True)
    ]
    whole = solved == len(found)
    return {
        "kind": KIND,
        "seed": study.seed,
        "record": _shared_record(study, session),
        "source_digest": session.problem.origin.source_digest,
        "over": ", ".join(dims),
        "study": {"axes": axes, "shape": list(study.shape), "failed": failures},
        "solved": solved,
        "points": len(found),
        "survives": sum(row["survives"] == 1 for row in found),
        "status": "solved" if whole else f"{solved} of {len(found)} solved",
        "success": whole,
        "verdict": verdict(found, dims),
    }


def _shared_record(study: Grid, session: Session) -> dict[str, Any]:
    """What was asked and is the same at all points."""
    told = session_record(session, study.seed)
    swept = {axis.name for axis in study.axes}
    groups = {
        "params": "problem.",
        "contact_settings": "contact.",
        "law_parameters": "",
        "solver_options": "setting.",
        "policy_settings": "policy.",
    }
    for group, head in groups.items():
        told[group] = {k: v for k, v in told[group].items() if f"{head}{k}" not in swept}
    if "problem.N" in swept:
        del told["N"]
    ranked = {"rank": study.rank} if study.starts > 1 else {}
    return {**told, "starts": study.starts, **ranked}


def rows(data: xr.Dataset) -> list[dict[str, Any]]:
    """Every point: its coordinates and what it came to, the last axis fastest."""
    dims = [str(dim) for dim in data["cost"].dims]
    names = (*NUMBERS, "seconds", *COUNTS, *WORDS)
    count = data["cost"].size
    columns = {name: np.asarray(data[name].values).ravel().tolist() if name in data else [""] * count for name in names}
    places = itertools.product(*(data[dim].values.tolist() for dim in dims))
    return [
        {**dict(zip(dims, place, strict=True)), **{name: columns[name][i] for name in names}}
        for i, place in enumerate(places)
    ]


def verdict(found: list[dict[str, Any]], dims: list[str]) -> str:
    """Counts, and the cheapest and the dearest of the solved points; then what failed, a line each.

    Of the failed points a few are told.
    """
    solved = [row for row in found if row["success"]]
    judged = [row for row in solved if row["survives"] >= 0]
    count = "All" if len(solved) == len(found) else f"{len(solved)} of"
    told = f"{count} {len(found)} points are solved"
    if judged:
        survive = sum(row["survives"] for row in judged)
        words = {0: "none survives", 1: "one survives", len(solved): "all survive"}
        told += f", {words.get(survive, f'{survive} survive')} the referee"
    if solved:
        low, high = (pick(solved, key=lambda row: row["cost"]) for pick in (min, max))
        ends = [f"{row['cost']:.6g}" for row in (low, high)]
        span = f"from {ends[0]} at {where(low, dims)} to {ends[1]} at {where(high, dims)}"
        told += f"; cost {ends[0] if ends[0] == ends[1] else span}"
    failures, outliers = ([row for row in found if not row["success"]], [row for row in found if row.get("start")])
    lines = [
        f"outlier {where(row, dims)}: {row['own_cost']:.6g} alone, {row['cost']:.6g} from the plan at {row['start']}"
        for row in outliers[:_TOLD]
    ]
    lines += [f"{where(row, dims)}: {row['verdict']}".partition("\n")[0] for row in failures[:_TOLD]]
    if len(failures) > _TOLD:
        lines.append(f"and {len(failures) - _TOLD} more that failed")
    return "\n".join([f"{told}.", *lines])


_TOLD = 5


def where(row: dict[str, Any], dims: list[str]) -> str:
    """Coordinates of a point in words: ``M = 0.5, contact.mu = 0.001``."""
    return ", ".join(f"{dim} = {row[dim]:g}" for dim in dims)
