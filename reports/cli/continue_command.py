"""``ocp continue PROBLEM``: follow a solution along a parameter."""

from __future__ import annotations

import sys
from dataclasses import MISSING, dataclass
from typing import TYPE_CHECKING, Any

from reports.cli.options import Command, SolverOptions, option

if TYPE_CHECKING:
    from ocp.continuation import Continuation
    from reports.cli.request import Request

SCALES = {"log": "in equal ratios", "linear": "in equal steps"}


@dataclass(frozen=True, kw_only=True)
class ContinueOptions(SolverOptions):
    """What to follow, from where to where."""

    over: str = option(MISSING, "--over", help="Parameter, such as contact.mu or M.")
    start: float = option(MISSING, "--from", help="First value.")
    end: float = option(MISSING, "--to", help="Last value.")
    steps: int = option(20, "--steps", min=1, max=100_000, help="Steps that are asked for.")
    scale: str = option("linear", "--scale", help="log or linear.")


def check(options: ContinueOptions) -> Request:
    """Build the session, and see that the parameter may have both values."""
    from ocp.continuation import resolve
    from ocp.continuation.walk import check_range
    from ocp.effort import check_memory, points_memory
    from ocp.errors import InputError, choose
    from reports.cli.request import Request, assignments, check_places

    choose("scale", options.scale, SCALES)
    asked = Request.read(options)
    check_memory(f"--steps {options.steps}", points_memory(asked.session.problem, options.steps))
    check_places(options.out, options.pdf)
    name = resolve(asked.session, options.over)
    for value in (options.start, options.end):
        asked.check_value(name, value)
    check_range(options.scale, options.start, options.end, options.steps)
    law, _, knob = name.rpartition(".")
    option, given = ("-c", options.law_settings) if law == "contact" else ("-p", options.params)
    if (knob if law == "contact" else name) in assignments(option, given):
        raise InputError(f"{name} goes from --from to --to; drop {option} {knob}")
    return asked


def run(options: ContinueOptions, asked: Request) -> int:
    """Follow a solution along a parameter of the problem, the law or the start; store the path."""
    from ocp import store
    from ocp.continuation import curve_dataset
    from ocp.effort import FOLLOWED
    from reports.tables import event_table

    options.output.foretell(
        f"{options.steps} steps of {asked.spec.name}",
        options.steps * FOLLOWED * asked.session.seconds, asked.session.memory,
    )  # fmt: skip
    path, interrupted = _followed(options, asked)
    output, meta = options.output, _meta(options, asked, path)
    problem, data = asked.session.problem, curve_dataset(path)
    stored = store.write(options.out, problem.name, data, meta, store.shown(problem))
    if path.events:
        output.note(event_table(path.parameter, meta["events"]))
    output.say(meta["verdict"])
    output.finish(stored, meta, options.pdf, asked.spec)
    if interrupted:
        raise KeyboardInterrupt
    return 0 if path.broke is None else 3


def _followed(options: ContinueOptions, asked: Request) -> tuple[Continuation, bool]:
    """The path, and whether Ctrl-C ended it; what was finished by then is the path."""
    from ocp.continuation import Continuation, continue_over, resolve
    from ocp.errors import interruptible
    from reports.cli import interrupt
    from reports.tables import curve_lines

    session, over, finished = asked.session, options.over, []

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


def _meta(options: ContinueOptions, asked: Request, path: Continuation) -> dict[str, Any]:
    return {
        "kind": "continue",
        "argv": options.argv,
        "tags": options.tags,
        "seed": options.seed,
        "record": {**path.points[0].solution.record, **asked.origin},
        "source_digest": asked.session.problem.source_digest,
        "over": path.parameter,
        "from": options.start,
        "to": options.end,
        "steps": options.steps,
        "scale": options.scale,
        "unit": _unit(asked.session, path.parameter),
        "points": [point.row() for point in path.points],
        "events": [event.row() for event in path.events],
        "iterations": path.iterations,
        "nlp_builds": path.nlp_builds,
        "success": path.broke is None,
        "status": "solved" if path.broke is None else "broke",
        "verdict": _verdict(path, options.end),
    }


def _unit(session: Any, name: str) -> str:
    for table in (session.problem.parameters, session.step.p):
        if name in table:
            return table.get(name).unit
    return ""


def _verdict(path: Any, end: float) -> str:
    from ocp.continuation.events import describe_events

    happened = describe_events(path.events, path.parameter)
    events = f"\nOn the way {happened}." if happened else ""
    if path.broke is not None:
        return f"The path broke {path.broke}{events}"
    first, last = path.points[0].solution, path.points[-1].solution
    word = last.referee.word
    fate = f"; before the referee it {word}" if last.referee.survives is False else ""
    return (
        f"Followed to {path.parameter} = {end:g}: cost from {first.cost:.6g} to {last.cost:.6g},"
        f" under exact physics {last.audit.exact_cost:.6g} there{fate}.{events}"
    )


COMMAND = Command(
    ContinueOptions,
    check,
    run,
    examples=(
        "continue push-disc --over contact.mu --from 1e-1 --to 1e-5 --scale log",
        "continue push-1d --over M --from 1 --to 2 --contact exact --pdf path.pdf",
    ),
)
