"""``ocp solve PROBLEM``: solve, audit, store, report."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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

if TYPE_CHECKING:
    from ocp.solution import Solution, StageRecord
    from ocp.solve import Rank

NOT_CONVERGED = 3
RANKS: dict[str, Rank] = {"planned": "planned", "referee": "referee"}
REQUIREMENTS = {"survives": "the referee's replay stays with the plan"}


def run(
    problem: Annotated[str, typer.Argument(help="Registered name or path/to/file.py.")],
    params: Params = None,
    contact: Contact = "barrier",
    law_settings: LawSettings = None,
    method: Method = "direct",
    policy: PolicyName = "open-loop",
    solver: SolverName = "ipopt",
    settings: Settings = None,
    start: Annotated[
        str | None,
        typer.Option("--from", metavar="RUN", help="Start at a stored run of the same problem."),
    ] = None,
    starts: Annotated[int, typer.Option("--starts", min=1, help="Perturbed guesses.")] = 1,
    rank: Annotated[
        str, typer.Option("--rank", help="Several starts by their cost: planned or referee.")
    ] = "planned",
    require: Annotated[
        str | None,
        typer.Option("--require", metavar="survives", help="Exit 3 unless the plan survives."),
    ] = None,
    seed: Seed = 0,
    out: Out = Path("runs"),
    pdf: Annotated[Path | None, typer.Option("--pdf", help="Write a report here.")] = None,
    as_json: Json = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> int:
    """Solve a problem under a contact law, audit the answer, and store the run."""
    from ocp import store
    from ocp.solution import Interrupted
    from ocp.solve import solve
    from reports import console
    from reports.cli import interrupt
    from reports.cli.choices import choose
    from reports.cli.request import Request, check_pdf_place

    rank_by = choose("rank", rank, RANKS)
    if require is not None:
        choose("requirement", require, REQUIREMENTS)
    asked = Request.read(
        problem=problem, params=params, contact=contact, law_settings=law_settings, method=method,
        policy_name=policy, solver=solver, settings=settings,
    )  # fmt: skip
    store.check_writable(out)
    check_pdf_place(pdf)
    origin = asked.start(start, out) if start is not None else None
    output = Output(as_json, quiet)
    with console.progress(quiet, f"{asked.spec.name}: building") as report:

        def told(stage: StageRecord) -> None:
            report(stage)
            interrupt.check()

        try:
            solution = solve(
                asked.problem, contact=asked.law, transcription=asked.method,
                policy=asked.policy, solver=asked.solver, settings=asked.settings, starts=starts,
                seed=seed, progress=told, start=origin, rank_by=rank_by,
            )  # fmt: skip
        except Interrupted as stop:
            kept = store.save(asked.described(stop.solution), out, ["ocp", *sys.argv[1:]])
            output.say(f"run: {kept} (the best of {len(stop.solution.others)} finished starts)")
            raise
    solution = asked.described(solution)
    path = store.save(solution, out, ["ocp", *sys.argv[1:]])
    show(output, solution)
    if solution.record["jit"] not in (None, "compiled"):
        output.say(f"jit: {solution.record['jit']}")
    output.verdict(solution.verdict, solution.grade)
    output.say(f"run: {path}")
    if pdf is not None:
        from reports.pdf import write_pdf

        write_pdf([store.load(path)], pdf)
        output.say(f"PDF: {pdf}")
    output.document(document(solution, path, pdf))
    survives = require is None or bool(solution.referee.survives)
    return 0 if solution.success and survives else NOT_CONVERGED


def show(output: Output, solution: Solution) -> None:
    """Print the homotopy table, the audit, contacts and, for a failure, the worst constraints."""
    from reports import console

    if solution.stages:
        output.note(console.stage_table(solution.stages))
    output.note(console.result_table(solution))
    if solution.audit.contacts:
        output.note(console.contact_table(solution.audit))
    if solution.audit.worst and not solution.success:
        output.note(console.violation_table(solution))
    if solution.others:
        output.note(console.starts_table(solution.others))


def document(solution: Solution, path: Path, pdf: Path | None = None) -> dict[str, Any]:
    """Return what ``ocp solve --json`` prints."""
    from dataclasses import asdict

    from ocp import store

    meta = store.read_meta(path)
    record, audit, certificate = solution.record, asdict(solution.audit), solution.certificate
    return {
        **{key: record.get(key) for key in ("problem", "contact", "method", "policy", "solver")},
        "status": solution.status.label,
        "success": solution.success,
        "verdict": solution.verdict,
        "cost": solution.cost,
        "iterations": solution.iterations,
        "build_s": solution.build_s,
        "solve_s": solution.solve_s,
        "evaluation_s": solution.evaluation_s,
        "solver_s": solution.solver_s,
        "iteration_s": solution.iteration_s,
        **audit,
        "stationarity": certificate.stationarity,
        "stationarity_kind": certificate.kind,
        **{
            key: getattr(certificate, key)
            for key in ("biactive", "lpec_decrease", "kkt_residual", "negative_curvature")
        },
        "moves": [str(move) for move in certificate.moves],
        "certificate_s": certificate.seconds,
        "idle_cost": solution.idle_cost,
        "referee_cost": solution.referee.cost,
        "referee_gap": solution.referee.gap,
        "survives": solution.referee.survives,
        "refined_cost": solution.referee.refined_cost,
        "referee": asdict(solution.referee),
        "grade": solution.grade,
        "stages": [asdict(stage) for stage in solution.stages],
        "others": solution.others,
        "run": str(path),
        "hash": meta["hash"],
        "pdf": None if pdf is None else str(pdf),
        "params": record.get("params", record.get("parameters")),
        "settings": record.get("settings"),
        "seed": record.get("seed"),
        "from": record.get("from"),
        "jit": record.get("jit"),
        "versions": meta["versions"],
    }
