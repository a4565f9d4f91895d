"""``ocp export RUN|PROBLEM -o FILE.c``: step, derivatives and policy as one freestanding C file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version

import numpy as np

from dynamics.batch import TabulatedPolicy, c_identifier, export_step
from dynamics.contact import ContactLaw, Step
from dynamics.contact.learned_step import LearnedStep
from ocp.errors import InputError, did_you_mean
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import policy_name
from ocp.solution import Solution
from ocp.store import atomic
from ocp.transcription.factories import DEFAULT_LAW, make_law
from problems import names, spec
from problems.plugin import law_of, problem_of
from problems.registry import objective_names
from reports.cli.options.output import ExportOptions
from reports.cli.request import check_output_file, parse_assignments


@dataclass(frozen=True)
class ExportRequest:
    """Checked request of ``ocp export``: a problem under a law, and the solution of a run if one is given."""

    name: str
    title: str
    problem: Problem
    law: ContactLaw
    solution: Solution | None = None
    run: str | None = None

    @property
    def policy_name(self) -> str | None:
        """Kind of the run's policy, ``open-loop`` or ``feedback``; None without a run."""
        return None if self.solution is None else policy_name(self.solution.inputs)

    @cached_property
    def step(self) -> Step:
        """Time step of the problem's system under the contact law."""
        return self.law.close(self.problem.system)

    @property
    def values(self) -> np.ndarray:
        """Values of the step's parameters at the problem's defaults."""
        defaults = self.problem.parameters.defaults
        return Evaluation(self.problem, defaults).step_values(self.step, with_law_values=False)

    @property
    def policy(self) -> TabulatedPolicy | None:
        """The inputs of the run, or its feedback gains with the bounds on u; None without a run."""
        if self.solution is None:
            return None
        gains = self.solution.gains
        if gains is None:
            return TabulatedPolicy(self.solution.data["u"].values[0])
        limits = self.problem.limits(self.problem.parameters.values)
        lower, upper = (limit.full().ravel() for limit in limits[2:4])
        return TabulatedPolicy(gains.k, gains.K, lower, upper)

    @property
    def about(self) -> list[str]:
        """Comment lines at the top of the C file."""
        settings = ", ".join(f"{key} = {value}" for key, value in self.law.settings().items())
        law = f"contact law: {self.law.name}" + (f" ({settings})" if settings else "")
        policy = [] if self.run is None else [f"policy: {self.policy_name}, of the run {self.run}"]
        wrote = f"written by ocp export, centralpath {version('centralpath')}"
        return [f"{self.name}: {self.title}", law, *policy, wrote]


def check(options: ExportOptions) -> ExportRequest:
    """Return the step and policy to export; raises InputError for a law without C code."""
    request = _find(options)
    if isinstance(request.step, LearnedStep):
        raise InputError(
            f"contact law {request.law.name}: a learned step cannot be exported to C; choose another law with --contact"
        )
    return request


def _find(options: ExportOptions) -> ExportRequest:
    """Return the request for the problem or the run given as argument."""
    check_output_file(options.file, "C file")
    name, law_settings = options.subject, parse_assignments("-c", options.law_settings)
    if not options.named_runs:
        if "out" in options.explicit:
            raise InputError(f"--out is for a run, but {name} is a problem; drop it")
        if options.source is not None:
            raise InputError(f"--source is for a run, but {name} is a problem; drop it")
        problem_spec = spec(name)
        problem = problem_spec.problem(parse_assignments("-p", options.params))
        law = make_law(options.contact or DEFAULT_LAW, law_settings, problem.system)
        return ExportRequest(problem_spec.name, problem_spec.title, problem, law)
    return _read_run(name, options, law_settings)


def _read_run(name: str, options: ExportOptions, law_settings: dict[str, str]) -> ExportRequest:
    """Return the request for a run; an unknown name raises InputError with the closest problem's name."""
    if name in objective_names():
        raise InputError(f"{name} is an objective without dynamics and has no step to export")
    try:
        run = options.stored(name)
    except InputError as error:
        hint = f"; no problem has this name either{did_you_mean(name, names())}"
        raise InputError(f"{error}{'' if name.startswith('@') else hint}") from error
    run.check_solve()
    problem_spec, _, problem = problem_of(run, options.problem_from_source([run]))
    solution = run.solution(problem)
    if solution.controller is not None:
        raise InputError(
            f"{name}: the run's policy is a controller, which plans again at every step and cannot be written as C;"
            f" export the step of the problem {problem_spec.name}, or run the controller with ocp mpc"
        )
    if options.params:
        raise InputError(f"-p: a run has fixed parameters; to choose them export the problem {problem_spec.name}")
    law, warning = law_of(run, options.contact, law_settings, problem.system)
    if warning:
        options.output.say(warning)
    return ExportRequest(problem_spec.name, problem_spec.title, problem, law, solution, run.path.name)


def run(options: ExportOptions, request: ExportRequest) -> int:
    """Write a problem's step, its derivatives and a run's policy as a C11 file and a header."""
    text, header = export_step(request.step, request.values, request.name, request.about, request.policy)
    header_file = options.file.with_suffix(".h")
    # No header is written next to a FIFO or a device.
    is_regular_file = options.file.is_file() or not options.file.exists()
    atomic.write_file(options.file, text.encode(), "the C file")
    if is_regular_file:
        atomic.write_file(header_file, header.encode(), "the header")
    rule = f"{options.file.stem}.o: {options.file.name} ; cc -std=c11 -O2 -ffp-contract=off -c $<"
    name = c_identifier(request.name)
    functions = [f"{name}_step", f"{name}_derivatives"]
    if request.policy is not None:
        functions.append(f"{name}_policy")
    options.output.say(f"C file: {options.file} ({', '.join(functions)})")
    if is_regular_file:
        options.output.say(f"header: {header_file}")
    options.output.say(f"Makefile: {rule}")
    options.output.document(
        {
            "file": str(options.file),
            "header": str(header_file) if is_regular_file else None,
            "makefile": rule,
            "problem": request.name,
            "contact": request.law.name,
            "contact_settings": request.law.settings(),
            "run": request.run,
            "policy": request.policy_name,
            "functions": functions,
            "bytes": len(text.encode()),
        }
    )
    return 0
