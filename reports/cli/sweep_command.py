"""``ocp sweep``, a grid of solves in parallel, and ``ocp continue``, a path of solutions."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import Any, cast

import xarray as xr

from dynamics.systems import LAW_PREFIX
from ocp import store
from ocp.continuation import Continuation, continue_over, curve_dataset, resolve
from ocp.continuation.events import describe_events
from ocp.continuation.walk import check_range, check_value
from ocp.errors import InputError, interruptible
from ocp.jobs.grid import Grid, dimension_name, grid_dataset, load_points, parse_axes
from ocp.jobs.scheduling import Workers
from ocp.jobs.sweep import make_grid, solve_grid
from ocp.jobs.sweep_job import JobResult
from ocp.jobs.sweep_record import describe_point, grid_rows, run_meta
from ocp.problem.resources import FOLLOWED, check_memory, points_memory
from ocp.routes.session import Session
from ocp.solve.starts import Rank
from ocp.store.checkpoint import Checkpoint
from reports.cli import interrupt
from reports.cli.commands import ContinueOptions, SweepOptions
from reports.cli.request import Request, check_outputs, parse_assignments, read_request
from reports.cli.solve_command import NOT_CONVERGED
from reports.tables.listings import curve_lines, event_table, point_table, sweep_progress


@dataclass(frozen=True)
class SweepRequest:
    """Checked request of ``ocp sweep``: grid, session of its first point, and checkpoint of finished points."""

    study: Grid
    session: Session
    checkpoint: Checkpoint


def check(options: SweepOptions) -> SweepRequest:
    """Read the grid, build its first point, and check memory and output files."""
    over = parse_axes(options.over or ())
    study = make_grid(read_request(options)[1], over, options.starts, options.seed, cast("Rank", options.rank))
    session = study.check(options.jobs)
    check_outputs(options.out, options.pdf)
    return SweepRequest(study, session, study.checkpoint(options.out, session.problem.name))


def run(options: SweepOptions, request: SweepRequest) -> int:
    """Solve a problem at every point of a grid, in parallel processes or on a Dask cluster."""
    output, study = options.output, request.study
    count, session = math.prod(study.shape), request.session
    output.announce(
        f"{count} points", count * options.starts * session.seconds / options.jobs, session.memory * options.jobs
    )
    with request.checkpoint as checkpoint:
        data = grid_dataset(study, request.session, _points(options, request))
        meta = {
            **run_meta(study, request.session, data),
            "argv": options.argv,
            "tags": options.tags or (),
        }
        problem = request.session.problem
        stored = store.write_run(options.out, problem.name, data, meta, store.problem_parts(problem))
        checkpoint.discard()
    dims = [axis["name"] for axis in meta["study"]["axes"]]
    grid_points = grid_rows(data)
    output.note(point_table(grid_points, dims))
    output.say(meta["verdict"])
    for failure in meta["study"]["failed"]:
        output.note(f"to reproduce: {failure['command']}")
    output.finish(stored, _document(meta, grid_points, data), options.pdf, study.source)
    finite = all(math.isfinite(value) for value in data["exact_cost"].values.flat)
    return 0 if meta["success"] and finite else NOT_CONVERGED


def _points(options: SweepOptions, request: SweepRequest) -> list[JobResult]:
    """Return the results at all points; print how many were resumed and, after Ctrl-C, how to resume."""
    study, output = request.study, options.output
    dims = [dimension_name(axis.name) for axis in study.axes]
    names = [describe_point(dict(zip(dims, point.values(), strict=True)), dims) for point in study.point_values]
    for line in request.checkpoint.notes:
        output.say(line)
    saved = load_points(study, request.checkpoint)
    if saved:
        output.say(f"resumed; {len(saved)} of {len(names)} points already complete")
    try:
        with sweep_progress(names, len(saved), options.quiet) as on_point:
            return solve_grid(
                study,
                Workers(options.jobs, options.scheduler),
                request.checkpoint,
                saved,
                on_point,
                lambda *_: interrupt.raise_if_interrupted(),
            )
    except KeyboardInterrupt:
        output.say(f"{len(saved)} of {len(names)} points are kept; the same command resumes")
        raise


def _document(meta: dict[str, Any], points: list[dict[str, Any]], data: xr.Dataset) -> dict[str, Any]:
    names = ("problem", "contact", "method", "policy", "solver", "starts")
    return {
        **{name: meta["record"][name] for name in names},
        "axes": meta["study"]["axes"],
        "points": points,
        "failed": meta["study"]["failed"],
        **{name: meta[name] for name in ("solved", "survives", "success", "status", "verdict", "seed")},
        "arrays": {str(name): list(array.dims) for name, array in data.data_vars.items()},
    }


def check_continue(options: ContinueOptions) -> Request:
    """Return the request with its session, after checks of the parameter's range and of memory."""
    request = Request.read(options)
    check_memory(f"--steps {options.steps}", points_memory(request.session.problem, options.steps))
    check_outputs(options.out, options.pdf)
    name = resolve(request.session, options.over)
    for value in (options.start, options.end):
        if not name.startswith(LAW_PREFIX):
            request.spec.params({**request.params, name.removeprefix("problem."): value})
        check_value(request.session, name, value)
    check_range(options.scale, options.start, options.end, options.steps)
    law, _, parameter = name.rpartition(".")
    option, setting_words = ("-c", options.law_settings) if law == "contact" else ("-p", options.params)
    if (parameter if law == "contact" else name) in parse_assignments(option, setting_words):
        raise InputError(f"{name} is varied from --from to --to; drop {option} {parameter}")
    return request


def run_continue(options: ContinueOptions, request: Request) -> int:
    """Continue a solution along a parameter of problem, law or start, and store the path."""
    options.output.announce(
        f"{options.steps} steps of {request.spec.name}",
        options.steps * FOLLOWED * request.session.seconds,
        request.session.memory,
    )
    path, interrupted = _follow_path(options, request)
    output, meta = options.output, _meta(options, request, path)
    problem, data = request.session.problem, curve_dataset(path)
    stored = store.write_run(options.out, problem.name, data, meta, store.problem_parts(problem))
    if path.events:
        output.note(event_table(path.parameter, meta["events"]))
    output.say(meta["verdict"])
    output.finish(stored, meta, options.pdf, request.spec)
    if interrupted:
        raise KeyboardInterrupt
    return 0 if path.break_reason is None else NOT_CONVERGED


def _follow_path(options: ContinueOptions, request: Request) -> tuple[Continuation, bool]:
    """Return the path of solutions, and whether Ctrl-C ended it early; it then has only the finished points."""
    session, over, finished = request.session, options.over, []

    def note(point: Any) -> None:
        finished.append(point)
        if options.output.progress:
            lines = curve_lines(over, [point.row()], heads=len(finished) == 1)
            print("\n".join(lines), file=sys.stderr, flush=True)
        interrupt.raise_if_interrupted()

    try:
        with interruptible():
            grid = (over, options.start, options.end, options.steps, options.scale)
            return continue_over(session, *grid, progress=note, seed=options.seed), False
    except KeyboardInterrupt:
        if not finished:
            raise
    return Continuation(
        resolve(session, over),
        finished,
        iterations=sum(p.solution.iterations for p in finished),
        nlp_builds=session.nlp_builds,
        break_reason=f"after {over} = {finished[-1].value:g}: stopped by the user",
    ), True


def _meta(options: ContinueOptions, request: Request, path: Continuation) -> dict[str, Any]:
    over, problem = path.parameter, request.session.problem
    tables = (problem.parameters, request.session.step.p)
    return {
        "kind": "continue",
        **{name: getattr(options, name) for name in ("argv", "tags", "seed", "steps", "scale")},
        "record": {**path.points[0].solution.record, **request.origin},
        "source_digest": problem.origin.source_digest,
        "over": over,
        "from": options.start,
        "to": options.end,
        "unit": next((table.get(over).unit for table in tables if over in table), ""),
        "points": [point.row() for point in path.points],
        "events": [event.row() for event in path.events],
        "iterations": path.iterations,
        "nlp_builds": path.nlp_builds,
        "success": path.break_reason is None,
        "status": "solved" if path.break_reason is None else "broke",
        "verdict": _verdict(path, options.end),
    }


def _verdict(path: Any, end: float) -> str:
    changes = describe_events(path.events, path.parameter)
    events = f"\nAlong the path {changes}." if changes else ""
    if path.break_reason is not None:
        return f"The path broke {path.break_reason}{events}"
    first, last = path.points[0].solution, path.points[-1].solution
    referee = f"; referee: {last.referee.word}" if last.referee.survives is False else ""
    outliers = [point for point in path.points if point.neighbour_cost is not None]
    if outliers:
        values = ", ".join(f"{point.value:g}" for point in outliers)
        events += (
            f"\nOutliers: at {path.parameter} = {values} a neighbouring point's plan costs less (neighbour_cost in"
            " --json); follow the curve from the other end, or solve there with --effort thorough."
        )
    return (
        f"Continued to {path.parameter} = {end:g}: cost from {first.cost:.6g} to {last.cost:.6g},"
        f" under the exact law {last.audit.exact_cost:.6g} there{referee}.{events}"
    )
