"""``ocp continue PROBLEM``: follow a solution along a parameter."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from reports.cli.common import (
    Contact,
    Debug,
    Json,
    LawSettings,
    Method,
    Out,
    Output,
    Params,
    PolicyName,
    Quiet,
    Seed,
    Settings,
    SolverName,
)


def run(
    problem: Annotated[str, typer.Argument(help="Registered name or path/to/file.py.")],
    over: Annotated[str, typer.Option("--over", help="Parameter, such as contact.mu or M.")],
    start: Annotated[float, typer.Option("--from", help="First value.")],
    end: Annotated[float, typer.Option("--to", help="Last value.")],
    steps: Annotated[int, typer.Option("--steps", min=1, help="Steps that are asked for.")] = 20,
    scale: Annotated[str, typer.Option("--scale", help="log or linear.")] = "linear",
    params: Params = None,
    contact: Contact = "barrier",
    law_settings: LawSettings = None,
    method: Method = "direct",
    policy: PolicyName = "open-loop",
    solver: SolverName = "ipopt",
    settings: Settings = None,
    seed: Seed = 0,
    out: Out = Path("runs"),
    pdf: Annotated[Path | None, typer.Option("--pdf", help="Write a report here.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> int:
    """Follow a solution along a parameter of the problem, the law or the start; store the path."""
    from ocp import store
    from ocp.continuation import Continuation, continue_over, curve_dataset, resolve
    from ocp.solve import new_session
    from reports import console
    from reports.cli import interrupt
    from reports.cli.choices import choose
    from reports.cli.request import Request, check_pdf_place

    choose("scale", scale, {"log": 0, "linear": 0})
    asked = Request.read(
        problem=problem, params=params, contact=contact, law_settings=law_settings, method=method,
        policy_name=policy, solver=solver, settings=settings,
    )  # fmt: skip
    store.check_writable(out)
    check_pdf_place(pdf)
    output = Output(as_json, quiet)
    session = new_session(
        asked.problem, asked.law, asked.method, asked.policy, asked.solver, asked.settings
    )
    known = dict.fromkeys([*session.problem.parameters.names, *session.step.p.names])
    choose("parameter", over.removeprefix("problem."), known)
    for end_value in (start, end):
        asked.check_value(over, end_value)
    finished: list[Any] = []

    def note(point: Any) -> None:
        finished.append(point)
        if not quiet:
            print(console.curve_line(over, point.row()), file=sys.stderr, flush=True)
        interrupt.check()

    interrupted = False
    try:
        path = continue_over(session, over, start, end, steps, scale, note, seed)
    except KeyboardInterrupt:
        if not finished:
            raise
        interrupted = True
        path = Continuation(
            resolve(session, over), finished,
            iterations=sum(p.solution.iterations for p in finished),
            nlp_builds=session.nlp_builds,
            broke=f"after {over} = {finished[-1].value:g}: stopped by the user",
        )  # fmt: skip
    record = {**path.points[0].solution.record, **asked.origin}
    rows = [point.row() for point in path.points]
    meta = {
        "kind": "continue",
        "argv": ["ocp", *sys.argv[1:]],
        "seed": seed,
        "record": record,
        "over": path.parameter,
        "from": start,
        "to": end,
        "steps": steps,
        "scale": scale,
        "unit": _unit(session, path.parameter),
        "points": rows,
        "events": [event.row() for event in path.events],
        "iterations": path.iterations,
        "nlp_builds": path.nlp_builds,
        "success": path.broke is None,
        "status": "solved" if path.broke is None else "broke",
        "verdict": _verdict(path, end),
    }
    stored = store.write(out, asked.problem.name, curve_dataset(path), meta)
    output.note(console.curve_table(path.parameter, rows))
    if path.events:
        output.note(console.event_table(path.parameter, meta["events"]))
    output.say(meta["verdict"])
    output.say(f"run: {stored}")
    if pdf is not None:
        from reports.pdf import write_pdf

        write_pdf([store.load(stored)], pdf)
        output.say(f"PDF: {pdf}")
    output.document({**meta, "run": str(stored), "pdf": None if pdf is None else str(pdf)})
    if interrupted:
        raise KeyboardInterrupt
    return 0 if path.broke is None else 3


def _unit(session: Any, name: str) -> str:
    for table in (session.problem.parameters, session.step.p):
        if name in table:
            return table.get(name).unit
    return ""


def _verdict(path: Any, end: float) -> str:
    from ocp.continuation.events import told

    happened = told(path.events, path.parameter)
    events = f"\nOn the way {happened}." if happened else ""
    if path.broke is not None:
        return f"The path broke {path.broke}{events}"
    first, last = path.points[0].solution, path.points[-1].solution
    return (
        f"Followed to {path.parameter} = {end:g}: cost from {first.cost:.6g} to {last.cost:.6g},"
        f" under exact physics {last.audit.exact_cost:.6g} there.{events}"
    )
