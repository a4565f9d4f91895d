"""``ocp solve PROBLEM``: solve, audit, store, report."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from reports.cli.options import Command, SolverOptions, option
from reports.cli.output import Output

if TYPE_CHECKING:
    from ocp.solution import Solution, StageRecord
    from ocp.solve import Rank
    from problems.spec import ProblemSpec
    from reports.cli.request import Request

NOT_CONVERGED = 3
RANKS: dict[str, Rank] = {"planned": "planned", "exact": "exact", "referee": "referee"}
REQUIREMENTS = {"survives": "the referee's replay stays with the plan, at h/4 too"}


@dataclass(frozen=True, kw_only=True)
class SolveOptions(SolverOptions):
    """Where to start, and what counts as done."""

    start: str | None = option(
        None, "--from", metavar="RUN", help="Start at a stored run of the same problem."
    )
    starts: int = option(1, "--starts", min=1, max=10_000, help="Perturbed guesses.")
    rank: str = option(
        "planned", "--rank", help="Several starts by their cost: planned, exact or referee."
    )
    jobs: int = option(
        1, "--jobs", "-j", min=1, max=1024, help="Starts side by side, in processes."
    )
    require: str | None = option(
        None, "--require", metavar="survives", help="Exit 3 unless the plan survives."
    )
    refine: bool = option(
        False, "--refine", help="Plan again at h/2, h/4, ... until the step no longer shows."
    )
    plot: Path | None = option(
        None, "--plot", metavar="FILE", help="Draw the solution into a .pdf, .svg or .png file."
    )


def check(options: SolveOptions) -> tuple[Request, Solution | None]:
    """Build the session, and read the solution to start at."""
    from ocp.errors import InputError, choose
    from ocp.judgement import halved
    from ocp.sweeps.sweep import check_side_by_side
    from reports.cli.request import Request, check_place, check_places
    from reports.papers.formats import format_of

    choose("rank", options.rank, RANKS)
    if options.require is not None:
        choose("requirement", options.require, REQUIREMENTS)
    if "rank" in options.given and options.starts == 1:
        raise InputError("--rank orders several starts and there is one; give --starts 2 or more")
    if "jobs" in options.given and options.starts == 1:
        raise InputError("--jobs solves several starts at a time; give --starts 2 or more")
    if options.start is not None and options.starts > 1:
        raise InputError("--from and several starts exclude each other; leave starts at 1")
    if options.plot is not None:
        format_of(options.plot)
        check_place(options.plot, "figure")
    asked = Request.read(options)
    if options.refine:
        halved(asked.session.problem, asked.session.values, 1)
    check_side_by_side(asked.session, min(options.jobs, options.starts))
    check_places(options.out, options.pdf)
    start = None if options.start is None else _start(asked, options)
    return asked, start


def _start(asked: Request, options: SolveOptions) -> Solution:
    """Return the stored solution that ``--from`` names, of this problem at its own parameters."""
    from ocp.errors import InputError
    from problems.plugin import edited, problem_of
    from reports.cli.runs_command import stored

    run, name = str(options.start), asked.session.problem.name
    found = stored(run, options.out)
    if found.meta["problem"] != name:
        raise InputError(
            f"--from {run}: that run is of {found.meta['problem']}, not of {name}; start from a run"
            f" of {name}"
        )
    if told := edited(found, asked.spec):
        options.output.say(f"--from {run}: {told}")
    solution = found.solution(problem_of(found, asked.spec)[2])
    return replace(solution, record={**solution.record, "hash": found.meta["hash"]})


def run(options: SolveOptions, checked: tuple[Request, Solution | None]) -> int:
    """Solve a problem under a contact law, audit the answer, and store the run."""
    from ocp import store

    asked, start = checked
    output, session = options.output, asked.session
    side_by_side = min(options.jobs, options.starts)
    several = f" from {options.starts} starts" if options.starts > 1 else ""
    output.foretell(
        f"{asked.spec.name}{several}", session.seconds * options.starts / side_by_side,
        session.memory * side_by_side,
    )  # fmt: skip
    solution = _solved(options, asked, start)
    path = store.save(solution, options.out, options.argv, options.tags or ())
    show(output, solution)
    if solution.record["jit"] not in (None, "compiled"):
        output.say(f"jit: {solution.record['jit']}")
    output.verdict(solution.verdict, solution.grade)
    told = document(solution, path)
    if options.plot is not None:
        _plot(path, options.plot, asked.spec)
        output.say(f"figure: {options.plot}")
        told["plot"] = str(options.plot)
    output.finish(path, told, options.pdf, asked.spec)
    survives = options.require is None or bool(solution.referee.survives)
    finite = math.isfinite(solution.cost) and math.isfinite(solution.audit.exact_cost)
    return 0 if solution.success and survives and finite else NOT_CONVERGED


def _plot(run: Path, file: Path, own: ProblemSpec) -> None:
    """Draw the bare figure of a stored run."""
    from ocp import store
    from ocp.store import atomic
    from reports.papers.bare import bare
    from reports.papers.formats import format_of

    atomic.write(file, bare(store.load(run), format_of(file), own=own), "the figure")


def _solved(options: SolveOptions, asked: Request, start: Solution | None) -> Solution:
    """Solve; after Ctrl-C the best point is the answer, between several starts the best of them."""
    from ocp import store
    from ocp.asking import builder
    from ocp.programs.status import Status
    from ocp.solution import Interrupted
    from ocp.solve import refine_from, solve_from
    from ocp.sweeps.starts import solve_starts
    from reports import console
    from reports.cli import interrupt
    from reports.cli.request import case_of

    with console.progress(options.output.progress, f"{asked.spec.name}: building") as report:

        def told(stage: StageRecord) -> None:
            report(stage)
            interrupt.check()

        try:
            if start is not None:
                found = solve_from(asked.session, start, options.seed, told)
            else:
                found = solve_starts(
                    asked.session, case_of(options), options.starts, options.seed, told,
                    RANKS[options.rank], options.jobs,
                )  # fmt: skip
            if not options.refine:
                return found
            return refine_from(asked.session, found, builder(asked.spec), options.seed, told)
        except Interrupted as stop:
            if stop.solution.status is Status.INTERRUPTED:
                interrupt.answered()
                return stop.solution
            kept = store.save(stop.solution, options.out, options.argv, options.tags or ())
            finished = len(stop.solution.others)
            options.output.say(f"run: {kept} (the best of {finished} finished starts)")
            raise


def show(output: Output, solution: Solution) -> None:
    """Print the homotopy table, the audit, contacts and, for a failure, the worst constraints."""
    from reports import console
    from reports.stages import left_out

    if solution.stages and output.table_of_stages:
        output.note(console.stage_table(solution.stages))
    if unseen := left_out(solution.stages):
        output.note(unseen)
    output.note(console.result_table(solution))
    if solution.audit.contacts:
        output.note(console.contact_table(solution.audit))
    if solution.audit.worst and not solution.success:
        output.note(console.violation_table(solution))
    if solution.others:
        output.note(console.starts_table(solution.others))


def document(solution: Solution, path: Path) -> dict[str, Any]:
    """Return what ``ocp solve --json`` prints, but for where the run and its report are."""
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
        "survives_at_h": solution.referee.survives_at_h,
        "refined_cost": solution.referee.refined_cost,
        "refined": record.get("refined"),
        "referee": asdict(solution.referee),
        "grade": solution.grade,
        "stages": [asdict(stage) for stage in solution.stages],
        "others": solution.others,
        "hash": meta["hash"],
        "params": record.get("params", record.get("parameters")),
        "settings": record.get("settings"),
        "seed": record.get("seed"),
        "from": record.get("from"),
        "jit": record.get("jit"),
        "versions": meta["versions"],
    }


COMMAND = Command(
    SolveOptions,
    check,
    run,
    examples=(
        "solve push-disc",
        "solve push-disc -p M=2 -p N=40 --contact exact --pdf plan.pdf",
        "solve push-disc --contact adaptive -c sigma=0.05 -s tol=1e-8 --tag soft",
        "solve push-disc -p goal_x=0.5 --from @last",
        "solve push-disc --contact exact --starts 8 --jobs 2 --rank exact",
    ),
)
