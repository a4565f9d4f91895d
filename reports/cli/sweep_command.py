"""``ocp sweep PROBLEM``: solve at every point of a grid, side by side; one stored study."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, cast

import xarray as xr

from ocp import store
from ocp.errors import InputError
from ocp.session import Session
from ocp.solve import Rank
from ocp.store.checkpoint import Checkpoint
from ocp.sweeps.grid import Grid, axes, dataset, dimension, saved_points
from ocp.sweeps.job import JobResult
from ocp.sweeps.sweep import (
    check_parallel_memory,
    check_points,
    make_grid,
    rows,
    run_meta,
    solve_grid,
    where,
)
from reports.cli import interrupt
from reports.cli.commands import SweepOptions
from reports.cli.request import case_of, check_places, read_names
from reports.cli.solve_command import NOT_CONVERGED
from reports.tables import point_table, sweep_progress


@dataclass(frozen=True)
class SweepRequest:
    """A checked study, the session of its first point, and the checkpoint of finished points."""

    study: Grid
    session: Session
    checkpoint: Checkpoint


def check(options: SweepOptions) -> SweepRequest:
    """Read the grid, build its first point, and check memory and places before any work."""
    if options.scheduler is not None and "jobs" in options.given:
        raise InputError("--jobs starts local processes, --scheduler uses a cluster; drop one")
    over = axes(options.over or ())
    study = make_grid(
        case_of(*read_names(options)),
        over,
        options.starts,
        options.seed,
        cast("Rank", options.rank),
    )
    session = study.check()
    check_parallel_memory(session, options.jobs)
    check_points(study, session)
    check_places(options.out, options.pdf)
    return SweepRequest(study, session, study.checkpoint(options.out, session.problem.name))


def run(options: SweepOptions, request: SweepRequest) -> int:
    """Solve a problem at every point of a grid, over processes or a Dask cluster."""
    output, study = options.output, request.study
    count, session = math.prod(study.shape), request.session
    output.announce(
        f"{count} points", count * options.starts * session.seconds / options.jobs,
        session.memory * options.jobs,
    )  # fmt: skip
    with request.checkpoint as checkpoint:
        data = dataset(study, request.session, _points(options, request))
        meta = {
            **run_meta(study, request.session, data),
            "argv": options.argv,
            "tags": options.tags or (),
        }
        problem = request.session.problem
        stored = store.write(options.out, problem.name, data, meta, store.problem_part(problem))
        checkpoint.discard()
    dims = [axis["name"] for axis in meta["study"]["axes"]]
    found = rows(data)
    output.note(point_table(found, dims))
    output.say(meta["verdict"])
    for failure in meta["study"]["failed"]:
        output.note(f"to reproduce: {failure['command']}")
    output.finish(stored, _document(meta, found, data), options.pdf, study.source)
    finite = all(math.isfinite(value) for value in data["exact_cost"].values.flat)
    return 0 if meta["success"] and finite else NOT_CONVERGED


def _points(options: SweepOptions, request: SweepRequest) -> list[JobResult]:
    """All points; reports kept points, and after Ctrl-C how to resume."""
    study, output = request.study, options.output
    dims = [dimension(axis.name) for axis in study.axes]
    names = [where(dict(zip(dims, place.values(), strict=True)), dims) for place in study.places]
    for line in request.checkpoint.notes:
        output.say(line)
    found = saved_points(study, request.checkpoint)
    if found:
        output.say(f"resumed; {len(found)} of {len(names)} points already complete")
    try:
        with sweep_progress(names, len(found), options.quiet) as ended:
            return solve_grid(
                study, options.jobs, options.scheduler, request.checkpoint, found, ended,
                lambda *_: interrupt.check(),
            )  # fmt: skip
    except KeyboardInterrupt:
        output.say(f"{len(found)} of {len(names)} points are kept; the same command resumes")
        raise


def _document(
    meta: dict[str, Any], found: list[dict[str, Any]], data: xr.Dataset
) -> dict[str, Any]:
    names = ("problem", "contact", "method", "policy", "solver", "starts")
    return {
        **{name: meta["record"][name] for name in names},
        "axes": meta["study"]["axes"],
        "points": found,
        "failed": meta["study"]["failed"],
        **{name: meta[name] for name in ("solved", "survives", "success", "status", "verdict",
                                         "seed")},
        "arrays": {str(name): list(array.dims) for name, array in data.data_vars.items()},
    }  # fmt: skip
