"""``ocp solve MODEL.nl``: solve and certify a problem of AMPL, Pyomo or JuMP, and write its .sol file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ocp.errors import InputError, NotConverged
from ocp.mpcc.nl import NLProblem, read_nl, sol_text
from ocp.mpcc.solving import MPCCSolution, solve
from ocp.programs.solver import Solver
from ocp.store import atomic
from reports.cli.request import check_output_file, parse_assignments

if TYPE_CHECKING:
    from reports.cli.commands import SolveOptions

_USED = {"problem", "solver", "settings", "as_json", "quiet", "verbose", "debug"}
"""Options of ``ocp solve`` that apply to an .nl file."""


def check(options: SolveOptions) -> NLProblem:
    """Return the problem of the file; raise InputError for unused options or a .sol file that is not writable."""
    unused = sorted(options.explicit - _USED)
    if unused:
        listed = ", ".join(f"--{name.replace('_', '-')}" for name in unused)
        raise InputError(f"{listed} has no effect on an .nl file; it takes --solver and -s alone")
    problem = read_nl(Path(options.problem))
    if problem.contents.n_integer:
        raise InputError(
            f"{options.problem} has {problem.contents.n_integer} integer variables, expected real ones; relax them"
        )
    Solver(options.solver, solver_options(options))
    check_output_file(sol_path(options), "solution")
    return problem


def solver_options(options: SolveOptions) -> dict[str, Any]:
    """Return the options of the NLP solver that ``-s`` sets."""
    return dict(parse_assignments("-s", options.settings))


def sol_path(options: SolveOptions) -> Path:
    """Return the path of the .sol file, beside the .nl file."""
    return Path(options.problem).with_suffix(".sol")


def run(options: SolveOptions, problem: NLProblem) -> int:
    """Solve the problem, write the .sol file, and print the verdict."""
    solution = solve(problem.mpcc, problem.start, solver=options.solver, options=solver_options(options))
    path = sol_path(options)
    atomic.write_file(path, sol_text(problem, solution).encode(), "the solution")
    if problem.maximise:
        options.output.say(f"objective as stated, to be maximised: {problem.cost(solution):.8g}")
    options.output.verdict(solution.verdict, "certified" if solution.success else "failed")
    options.output.say(f"solution: {path}")
    options.output.document({**document_of(problem, solution), "sol": str(path)})
    return 0 if solution.success else NotConverged.exit_code


def document_of(problem: NLProblem, solution: MPCCSolution) -> dict[str, Any]:
    """Return the JSON document of a solution, with keys of ``ocp solve`` and the values of variables by name."""
    certificate, symbols = solution.certificate, problem.contents.x
    values = {symbols[i].name(): float(solution.x[i]) for i in range(symbols.numel())}
    return {
        "problem": problem.mpcc.name,
        "status": solution.status.label,
        "cost": problem.cost(solution),
        "solve_s": solution.seconds,
        "stationarity": certificate.stationarity,
        "stationarity_kind": certificate.kind,
        **{key: getattr(solution, key) for key in ("success", "verdict", "iterations", "strategy", "infeasibility")},
        **{key: getattr(certificate, key) for key in ("kkt_residual", "biactive", "lpec_decrease")},
        "findings": list(solution.findings),
        "x": values,
    }
