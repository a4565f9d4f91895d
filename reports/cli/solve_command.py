"""``ocp solve PROBLEM``: solve, audit, store, report; ``ocp replay RUN``: simulate a plan."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any, cast

from dynamics.contact import ContactLaw
from ocp import store
from ocp.errors import InputError, choose
from ocp.judge.constraints import describe_violations
from ocp.problem.resources import check_memory
from ocp.programs.solver import Status
from ocp.routes.homotopy import StageRecord
from ocp.simulators import SIMULATORS
from ocp.solution import Interrupted, Replay, Solution
from ocp.solve.refinement import divided_step
from ocp.solve.request import literal, rebuilder
from ocp.solve.solve import begin_at, climb_from, refine_from, solve_from
from ocp.solve.starts import Rank, check_until, is_greater, solve_session
from ocp.store import atomic
from ocp.store.stored_run import StoredRun
from problems.plugin import edited, law_of, problem_of
from reports.cli import interrupt
from reports.cli.commands import ReplayOptions, SolveOptions
from reports.cli.files.guess_file import read_guess
from reports.cli.request import Request, check_output_file, check_outputs, parse_assignments
from reports.cli.streams import Output
from reports.tables import console
from reports.tables.console import number, small
from reports.tables.contacts import contact_table
from reports.tables.survival import disturbance_table, ladder_table

if TYPE_CHECKING:
    from ocp.mpcc.nl import NLProblem

NOT_CONVERGED = 3
"""Exit code of a solve without a solution."""
REQUIREMENTS = {"survives": "the referee's replay follows the plan, at h and at h/4"}
"""Mapping from values of ``--require`` to their meaning."""


def check(options: SolveOptions) -> tuple[Request, Solution | None] | NLProblem:
    """Return the checked request and the solution to start from (None without ``--from``), or an .nl file's problem."""
    if options.problem.endswith(".nl"):
        from reports.cli.files import nl_command

        return nl_command.check(options)
    if options.require is not None:
        choose("requirement", options.require, REQUIREMENTS)
    parallel = [f"--{name}" for name in ("jobs", "scheduler") if name in options.explicit]
    if parallel and options.starts == 1:
        raise InputError(f"{parallel[0]} needs several starts; give --starts 2 or more")
    if options.start is not None and options.starts > 1:
        raise InputError("--from excludes several starts; drop --starts")
    if options.plot is not None:
        from reports.figures.paper import format_of

        format_of(options.plot)
        check_output_file(options.plot, "figure")
    request = Request.read(options)
    if options.start is not None and is_greater(literal(options.effort)):
        raise InputError(f"--effort {options.effort} would have no effect with --from; drop one of them")
    if options.search and (options.starts > 1 or options.start is not None):
        raise InputError("--search finds its own starts; drop --starts and --from")
    if options.guess is not None and (options.starts > 1 or options.start is not None):
        raise InputError("--guess says where to begin; drop --starts and --from")
    guess = None if options.guess is None else read_guess(options, options.guess)
    session = begin_at(request.session, guess, options.search, literal(options.effort))
    request = replace(request, session=session)
    if options.refine:
        divided_step(request.session.problem, request.session.values, 1)
    check_until(options.until, request.session)
    if options.world is not None:
        from ocp.simulators.mujoco_world import MujocoWorld

        choose("world", options.world, SIMULATORS)
        MujocoWorld(request.session.problem, request.session.values)
    workers = min(options.jobs, options.starts)
    for name in options.sensitivity or ():
        choose("parameter", name, dict.fromkeys(request.session.step.p.names))
    check_memory(f"{workers} solves in parallel", workers * request.session.memory)
    check_outputs(options.out, options.pdf)
    start = None if options.start is None else _start(request, options)
    return request, start


def _start(request: Request, options: SolveOptions) -> Solution:
    """Return the stored solution of ``--from``; raises InputError if it solves another problem."""
    run, name = str(options.start), request.session.problem.name
    stored_run = options.stored(run)
    if stored_run.meta["problem"] != name:
        raise InputError(
            f"--from {run}: the run solves {stored_run.meta['problem']}, not {name}; start from a run of {name}"
        )
    if warning := edited(stored_run, request.spec):
        options.output.say(f"--from {run}: {warning}")
    return stored_run.solution(problem_of(stored_run, request.spec)[2])


def run(options: SolveOptions, checked: tuple[Request, Solution | None] | NLProblem) -> int:
    """Solve a problem under a contact law, audit the answer, and store the run."""
    if not isinstance(checked, tuple):
        from reports.cli.files import nl_command

        return nl_command.run(options, checked)
    request, start = checked
    output, session = options.output, request.session
    workers = min(options.jobs, options.starts)
    several = f" from {options.starts} starts" if options.starts > 1 else ""
    output.announce(
        f"{request.spec.name}{several}", session.seconds * options.starts / workers, session.memory * workers
    )
    solution = _solved(options, request, start)
    if options.world is not None:
        replay = solution.replay_in(options.world)
        solution = replace(solution, simulator={**replay.document, "sentence": replay.sentence})
    if options.sensitivity:
        slopes = {name: _cost_slopes(solution, name) for name in options.sensitivity}
        solution = replace(solution, sensitivities=slopes)
    stored = store.save(solution, options.out, options.argv, options.tags or ())
    print_solution(output, solution)
    if solution.record["jit"] not in (None, "compiled"):
        output.say(f"jit: {solution.record['jit']}")
    output.verdict(solution.verdict, solution.grade)
    content = solution_document(solution, stored.meta)
    if options.plot is not None:
        from reports.figures.paper import bare_figure, format_of

        figure_bytes = bare_figure(stored, format_of(options.plot), file_spec=request.spec)
        atomic.write_file(options.plot, figure_bytes, "the figure")
        output.say(f"figure: {options.plot}")
        content["plot"] = str(options.plot)
    output.finish(stored, content, options.pdf, request.spec)
    survives = (options.require or options.until) is None or bool(solution.referee.survives)
    finite = math.isfinite(solution.cost) and math.isfinite(solution.audit.exact_cost)
    return 0 if solution.success and survives and finite else NOT_CONVERGED


def _cost_slopes(solution: Solution, name: str) -> dict[str, Any]:
    """Return derivatives of planned and replayed costs by a parameter, or the reason why they do not exist."""
    try:
        sensitivity = solution.sensitivity(name)
    except InputError as error:
        return {"sentence": str(error)}
    slopes = {key: float(sensitivity[key]) for key in ("cost", "cost_referee", "cost_refined")}
    return {**slopes, "sentence": sensitivity.attrs["finding"]}


def _solved(options: SolveOptions, request: Request, start: Solution | None) -> Solution:
    """Return the solution; after Ctrl-C return the best iterate, or store the best of several starts and raise."""
    rank = cast("Rank", options.rank)
    with console.progress(options.output.progress, f"{request.spec.name}: building") as report:

        def on_stage(stage: StageRecord) -> None:
            report(stage)
            interrupt.raise_if_interrupted()

        try:
            if start is not None:
                solution = solve_from(request.session, start, options.seed, on_stage)
            elif options.starts == 1 or not options.parallel:
                solution = solve_session(request.session, options.starts, options.seed, on_stage, rank)
            else:
                from ocp.jobs.scheduling import Workers
                from ocp.jobs.sweep_job import solve_starts

                solution = solve_starts(
                    request.session,
                    request.solve_request.with_content(request.spec),
                    options.starts,
                    options.seed,
                    on_stage,
                    rank,
                    Workers(options.jobs, options.scheduler),
                )
            build = rebuilder(request.spec)
            if options.refine:
                solution = refine_from(request.session, solution, build, options.seed, on_stage)
            if options.until is None:
                return solution
            return climb_from(request.session, solution, build, options.seed, on_stage)
        except Interrupted as stop:
            if stop.solution.status is Status.INTERRUPTED or stop.solution.route.ladder is not None:
                interrupt.mark_handled()
                return stop.solution
            best_run = store.save(stop.solution, options.out, options.argv, options.tags or ())
            finished = len(stop.solution.route.attempts)
            options.output.say(f"run: {best_run.path} (the best of {finished} finished starts)")
            raise


def print_solution(output: Output, solution: Solution) -> None:
    """Print the homotopy table, the audit, contacts and, if the solve failed, the worst constraints."""
    # If stderr is no terminal, the stages were printed as lines during the solve.
    if solution.stages and output.console.is_terminal and output.progress:
        output.note(console.stage_table(solution.stages, solution.cost))
    if note := console.stage_note(solution.stages, solution.cost):
        output.note(note)
    output.note(console.result_table(solution))
    if solution.audit.contacts:
        output.note(contact_table(solution.audit))
    if solution.audit.worst and not solution.success:
        output.note(console.violation_table(solution))
    if solution.route.search is not None:
        output.note(str(solution.route.search))
    if solution.route.ladder is not None:
        output.note(ladder_table(solution.route.ladder))
        if solution.route.ladder.disturbed:
            output.note(disturbance_table(solution.route.ladder))
    if solution.route.attempts:
        output.note(console.starts_table(solution.route.attempts))


_REQUEST_KEYS = ("problem", "contact", "method", "policy", "solver", "settings", "seed", "from", "jit")
"""Keys of the JSON document that are in a run's record, and say what was requested."""
_ROUTE_KEYS = ("route", "refined", "ladder", "search", "world", "sensitivities")
"""Keys of the JSON document that are in a run's record, and say how the answer was found and what followed."""
_RESULT_KEYS = ("status", "verdict", "grade", "cost", "idle_cost", "iterations", "stages", "others", "referee")
"""Keys of the JSON document that are results in the metadata of a run."""
_META_KEYS = ("build_s", "solve_s", "evaluation_s", "solver_s", "hash", "versions")
"""Keys of the JSON document that are times, hash and versions in the metadata of a run."""
_CERTIFICATE_KEYS = ("stationarity", "biactive", "lpec_decrease", "kkt_residual", "negative_curvature")
"""Keys of the JSON document that the certificate has."""
_REFEREE_KEYS = ("survives", "survives_at_h", "refined_cost")
"""Keys of the JSON document that the referee's report has."""


def solution_document(solution: Solution, meta: Mapping[str, Any]) -> dict[str, Any]:
    """Return the JSON document of ``ocp solve``, without paths; ``meta`` is the metadata of the stored run."""
    record, certificate, referee = meta["record"], meta["certificate"], meta["referee"]
    return {
        **{key: record.get(key) for key in (*_REQUEST_KEYS, *_ROUTE_KEYS)},
        "params": record.get("params", record.get("parameters")),
        **{key: meta[key] for key in (*_RESULT_KEYS, *_META_KEYS)},
        "success": solution.success,
        "iteration_s": solution.iteration_s,
        "findings": [finding.document for finding in solution.findings],
        **meta["audit"],
        **{key: certificate[key] for key in _CERTIFICATE_KEYS},
        "stationarity_kind": certificate["kind"],
        "certificate_s": certificate["seconds"],
        "moves": [str(move) for move in solution.certificate.moves],
        **{key: referee[key] for key in _REFEREE_KEYS},
        "referee_cost": referee["cost"],
        "referee_gap": referee["gap"],
    }


ReplayRequest = tuple[StoredRun, Solution, ContactLaw | str]


def check_replay(options: ReplayOptions) -> ReplayRequest:
    """Return the run, its solution, and the contact law or the simulator of the replay."""
    if options.world is not None and options.explicit & {"contact", "law_settings"}:
        raise InputError("--world excludes a contact law; drop --contact and -c, or --world")
    if options.world is None and options.settings:
        raise InputError("-s sets the contact of another simulator; add --world mujoco, or set a law with -c")
    stored_run = options.stored(options.run)
    stored_run.check_solve()
    problem = problem_of(stored_run, options.problem_from_source([stored_run]))[2]
    solution = stored_run.solution(problem)
    if options.world is not None:
        return stored_run, solution, options.world
    law_settings = parse_assignments("-c", options.law_settings)
    law, warning = law_of(stored_run, options.contact, law_settings, problem.system)
    if warning:
        options.output.say(warning)
    return stored_run, solution, law


def run_replay(options: ReplayOptions, request: ReplayRequest) -> int:
    """Simulate the inputs, or the feedback policy, of a stored run under a law, or in another simulator."""
    (stored, solution, law), output = request, options.output
    if isinstance(law, str):
        external = solution.replay_in(law, **parse_assignments("-s", options.settings))
        output.say(external.sentence)
        output.document({"run": str(stored.path), "problem": stored.meta["problem"], **external.document})
        return 0 if math.isfinite(external.cost) else NOT_CONVERGED
    rolled = solution.replay(law)
    output.say(f"planned cost {number(rolled.planned_cost, 8)}; under the {law.name} law {number(rolled.cost, 8)}")
    deepest = rolled.between
    output.say(
        f"largest state difference {small(rolled.state_gap)};"
        f" penetration {small(rolled.penetration)} m"
        + ("" if deepest is None else f", between nodes {small(deepest.amount)} m")
    )
    for line in describe_violations(rolled.broken):
        output.say(line)
    output.document(replay_document(stored, rolled))
    return 0 if math.isfinite(rolled.cost) else NOT_CONVERGED


def replay_document(stored: StoredRun, rolled: Replay) -> dict[str, Any]:
    """Return the JSON document of ``ocp replay``.

    Among its keys, ``cost`` is the cost under the law of the replay, ``state_gap`` is max |x - x_replay|,
    ``penetration`` [m] is measured by the true signed distance, ``between`` is the deepest penetration between
    nodes, ``broken`` lists the constraints that the replay violates, ``final_state`` has shape (scenario,
    state), and ``inputs`` is "open-loop", "feedback" or "controller".
    """
    copied = ("inputs", "cost", "planned_cost", "state_gap", "penetration")
    return {
        "run": str(stored.path),
        "problem": stored.meta["problem"],
        "contact": rolled.law.name,
        "contact_settings": rolled.law.settings(),
        **{name: getattr(rolled, name) for name in copied},
        "between": None if rolled.between is None else asdict(rolled.between),
        "broken": [asdict(violation) for violation in rolled.broken],
        "final_state": rolled.data["x"].values[:, -1],
        "states": [str(name) for name in rolled.data["state"].values],
    }
