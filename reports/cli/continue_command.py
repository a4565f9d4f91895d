"""``ocp continue PROBLEM``: continue a solution along a parameter."""

from __future__ import annotations

import sys
from typing import Any

from dynamics.systems import LAW_PREFIX
from ocp import store
from ocp.continuation import Continuation, continue_over, curve_dataset, resolve
from ocp.continuation.events import describe_events
from ocp.continuation.walk import check_range, check_value
from ocp.effort import FOLLOWED, check_memory, points_memory
from ocp.errors import InputError, choose, interruptible
from reports.cli import interrupt
from reports.cli.commands import ContinueOptions
from reports.cli.request import Request, assignments, check_places
from reports.tables import curve_lines, event_table

SCALES = {"log": "in equal ratios", "linear": "in equal steps"}


def check(options: ContinueOptions) -> Request:
    """Build the session, and check the range of the parameter."""
    choose("scale", options.scale, SCALES)
    request = Request.read(options)
    check_memory(f"--steps {options.steps}", points_memory(request.session.problem, options.steps))
    check_places(options.out, options.pdf)
    name = resolve(request.session, options.over)
    for value in (options.start, options.end):
        if not name.startswith(LAW_PREFIX):
            request.spec.params({**request.params, name.removeprefix("problem."): value})
        check_value(request.session, name, value)
    check_range(options.scale, options.start, options.end, options.steps)
    law, _, parameter = name.rpartition(".")
    option, given = ("-c", options.law_settings) if law == "contact" else ("-p", options.params)
    if (parameter if law == "contact" else name) in assignments(option, given):
        raise InputError(f"{name} is varied from --from to --to; drop {option} {parameter}")
    return request


def run(options: ContinueOptions, request: Request) -> int:
    """Continue a solution along a parameter of problem, law or start, and store the path."""
    options.output.announce(
        f"{options.steps} steps of {request.spec.name}",
        options.steps * FOLLOWED * request.session.seconds, request.session.memory,
    )  # fmt: skip
    path, interrupted = _followed(options, request)
    output, meta = options.output, _meta(options, request, path)
    problem, data = request.session.problem, curve_dataset(path)
    stored = store.write(options.out, problem.name, data, meta, store.problem_part(problem))
    if path.events:
        output.note(event_table(path.parameter, meta["events"]))
    output.say(meta["verdict"])
    output.finish(stored, meta, options.pdf, request.spec)
    if interrupted:
        raise KeyboardInterrupt
    return 0 if path.broke is None else 3


def _followed(options: ContinueOptions, request: Request) -> tuple[Continuation, bool]:
    """The path, and whether Ctrl-C ended it; the path then holds the finished points."""
    session, over, finished = request.session, options.over, []

    def note(point: Any) -> None:
        finished.append(point)
        if options.output.progress:
            lines = curve_lines(over, [point.row()], heads=len(finished) == 1)
            print("\n".join(lines), file=sys.stderr, flush=True)
        interrupt.check()

    try:
        with interruptible():
            return continue_over(
                session, over, options.start, options.end, options.steps, options.scale, note,
                options.seed,
            ), False  # fmt: skip
    except KeyboardInterrupt:
        if not finished:
            raise
    return Continuation(
        resolve(session, over), finished,
        iterations=sum(p.solution.iterations for p in finished), nlp_builds=session.nlp_builds,
        broke=f"after {over} = {finished[-1].value:g}: stopped by the user",
    ), True  # fmt: skip


def _meta(options: ContinueOptions, request: Request, path: Continuation) -> dict[str, Any]:
    over, problem = path.parameter, request.session.problem
    tables = (problem.parameters, request.session.step.p)
    return {
        "kind": "continue",
        **{name: getattr(options, name) for name in ("argv", "tags", "seed", "steps", "scale")},
        "record": {**path.points[0].solution.record, **request.origin},
        "source_digest": problem.source_digest,
        "over": over,
        "from": options.start,
        "to": options.end,
        "unit": next((table.get(over).unit for table in tables if over in table), ""),
        "points": [point.row() for point in path.points],
        "events": [event.row() for event in path.events],
        "iterations": path.iterations,
        "nlp_builds": path.nlp_builds,
        "success": path.broke is None,
        "status": "solved" if path.broke is None else "broke",
        "verdict": _verdict(path, options.end),
    }


def _verdict(path: Any, end: float) -> str:
    happened = describe_events(path.events, path.parameter)
    events = f"\nAlong the path {happened}." if happened else ""
    if path.broke is not None:
        return f"The path broke {path.broke}{events}"
    first, last = path.points[0].solution, path.points[-1].solution
    word = last.referee.word
    fate = f"; referee: {word}" if last.referee.survives is False else ""
    return (
        f"Continued to {path.parameter} = {end:g}: cost from {first.cost:.6g} to {last.cost:.6g},"
        f" under the exact law {last.audit.exact_cost:.6g} there{fate}.{events}"
    )
