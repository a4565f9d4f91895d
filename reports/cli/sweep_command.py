"""``ocp sweep PROBLEM``: solve at every point of a grid, side by side; one stored study."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from reports.cli.options import Command, SolverOptions, option
from reports.cli.solve_command import NOT_CONVERGED, RANKS

if TYPE_CHECKING:
    import xarray as xr

    from ocp.session import Session
    from ocp.store.checkpoint import Checkpoint
    from ocp.sweeps.point import Point
    from ocp.sweeps.study import Study


@dataclass(frozen=True, kw_only=True)
class SweepOptions(SolverOptions):
    """What to go over, and who does the work."""

    over: list[str] | None = option(
        None, "--over", metavar="NAME=A:B:n[:log]",
        help="Values of a parameter, of contact.mu and its like, of setting.tol.",
    )  # fmt: skip
    starts: int = option(1, "--starts", min=1, max=10_000, help="Guesses at each point.")
    rank: str = option("planned", "--rank", help="Several starts by: planned, exact or referee.")
    jobs: int = option(1, "--jobs", "-j", min=1, max=1024, help="Processes side by side.")
    scheduler: str | None = option(
        None, "--scheduler", metavar="ADDRESS", help="Of a Dask cluster that takes the points."
    )


@dataclass(frozen=True)
class Asked:
    """A study that can be done, its first point built, and what is kept of it."""

    study: Study
    session: Session
    checkpoint: Checkpoint


def check(options: SweepOptions) -> Asked:
    """Read the grid, and build what can be known to fit before any work."""
    from ocp.errors import InputError, choose
    from ocp.sweeps.axes import axes
    from ocp.sweeps.sweep import asked, check_points, check_side_by_side
    from reports.cli.request import case_of, check_places

    choose("rank", options.rank, RANKS)
    if "rank" in options.given and options.starts == 1:
        raise InputError("--rank orders several starts and there is one; give --starts 2 or more")
    if options.scheduler is not None and "jobs" in options.given:
        raise InputError("--jobs are processes of this computer, --scheduler others; drop one")
    over = axes(options.over or ())
    case = case_of(options)
    study = asked(case, over, options.starts, options.seed, RANKS[options.rank])
    session = study.checked()
    check_side_by_side(session, options.jobs)
    check_points(study, session)
    check_places(options.out, options.pdf)
    return Asked(study, session, study.checkpoint(options.out, session.problem.name))


def run(options: SweepOptions, asked: Asked) -> int:
    """Solve a problem at every point of a grid, over processes or a Dask cluster.

    Each point is what ocp solve gives there. Finished points are kept: the same command goes on
    after Ctrl-C or a kill, and ends as if it had never stopped.
    """
    from ocp import store
    from ocp.sweeps.study import dataset
    from ocp.sweeps.summary import described, rows
    from reports.sweep_tables import point_table

    output, study = options.output, asked.study
    count, session = math.prod(study.shape), asked.session
    output.foretell(
        f"{count} points", count * options.starts * session.seconds / options.jobs,
        session.memory * options.jobs,
    )  # fmt: skip
    with asked.checkpoint as checkpoint:
        data = dataset(study, asked.session, _points(options, asked))
        meta = {
            **described(study, asked.session, data),
            "argv": options.argv,
            "tags": options.tags or (),
        }
        problem = asked.session.problem
        path = store.write(options.out, problem.name, data, meta, store.shown(problem))
        checkpoint.discard()
    dims = [axis["name"] for axis in meta["study"]["axes"]]
    found = rows(data)
    output.note(point_table(found, dims))
    output.say(meta["verdict"])
    for failure in meta["study"]["failed"]:
        output.note(f"to look at it: {failure['command']}")
    output.finish(path, _document(meta, found, data), options.pdf, study.source)
    finite = all(math.isfinite(value) for value in data["exact_cost"].values.flat)
    return 0 if meta["success"] and finite else NOT_CONVERGED


def _points(options: SweepOptions, asked: Asked) -> list[Point]:
    """All points; says what was done before, and how to go on where Ctrl-C stops it."""
    from ocp.sweeps.study import dimension, kept_points
    from ocp.sweeps.summary import where
    from ocp.sweeps.sweep import followed
    from reports.cli import interrupt
    from reports.sweep_tables import live

    study, output = asked.study, options.output
    dims = {axis.name: dimension(axis.name) for axis in study.axes}
    names = [
        where({dims[name]: value for name, value in place.items()}, [*dims.values()])
        for place in study.places
    ]
    for line in asked.checkpoint.notes:
        output.say(line)
    found = kept_points(study, asked.checkpoint)
    if found:
        output.say(f"went on: {len(found)} of {len(names)} points were done before")
    try:
        with live(names, len(found), options.quiet) as ended:
            return followed(
                study, options.jobs, options.scheduler, asked.checkpoint, found, ended,
                lambda *_: interrupt.check(),
            )  # fmt: skip
    except KeyboardInterrupt:
        output.say(f"{len(found)} of {len(names)} points are kept; the same command goes on")
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


COMMAND = Command(
    SweepOptions,
    check,
    run,
    examples=(
        "sweep push-disc --over M=0.5:2:7 --over contact.mu=1e-4:1e-1:4:log -j 2",
        "sweep push-1d --over N=10:40:4 --contact exact --starts 3 --pdf sweep.pdf",
    ),
)
