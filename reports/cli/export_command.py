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
from ocp.judge.step_size import step_size_kind
from ocp.mpc.rates import samples_per_step
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import Gains, policy_name
from ocp.solution import Solution
from ocp.store import atomic
from ocp.store.stored_run import StoredRun
from ocp.transcription.factories import DEFAULT_LAW, make_law
from problems import names, spec
from problems.plugin import law_of, problem_of
from problems.registry import objective_names
from reports.cli.options.output import ExportOptions
from reports.cli.request import check_output_file, parse_assignments


@dataclass(frozen=True)
class ExportRequest:
    """Checked request of ``ocp export``: a problem under a law, and the policy of a run if one is given.

    ``policy_name`` is ``open-loop`` or ``feedback``. ``samples_per_step`` samples of a closed loop make one step of
    the problem; the exported step is that of one sample.
    """

    name: str
    title: str
    problem: Problem
    law: ContactLaw
    policy: TabulatedPolicy | None = None
    policy_name: str | None = None
    run: str | None = None
    samples_per_step: int = 1

    @cached_property
    def step(self) -> Step:
        """Time step of the problem's system under the contact law."""
        return self.law.close(self.problem.system)

    @property
    def values(self) -> np.ndarray:
        """Values of the step's parameters at the problem's defaults, with the step size of one sample."""
        values = dict(self.problem.parameters.defaults)
        if self.samples_per_step > 1:
            values[step_size_kind(self.problem.system).parameter] /= self.samples_per_step
        return Evaluation(self.problem, values).step_values(self.step, with_law_values=False)

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
    if run.kind != "closed-loop":
        run.check_solve()
    if options.params:
        raise InputError(f"-p: a run has fixed parameters; to choose them export the problem {run.meta['problem']}")
    problem_spec, _, problem = problem_of(run, options.problem_from_source([run]))
    if run.kind == "closed-loop":
        policy, label, rate = _loop_policy(run, problem), "feedback", run.record.get("rate")
    else:
        (policy, label), rate = _solved_policy(name, run.solution(problem)), None
    law, warning = law_of(run, options.contact, law_settings, problem.system)
    if warning:
        options.output.say(warning)
    r = samples_per_step(problem, rate, {})
    return ExportRequest(problem_spec.name, problem_spec.title, problem, law, policy, label, run.path.name, r)


def _solved_policy(name: str, solution: Solution) -> tuple[TabulatedPolicy, str]:
    """Return the inputs of the solution of the run ``name``, or its feedback gains, and the kind of policy."""
    if solution.controller is not None:
        raise InputError(
            f"{name}: the run's policy is a controller, which plans again at every step and cannot be written as C;"
            f" export the step of the problem {solution.problem.name}, or the gains of a run of ocp mpc"
        )
    if solution.gains is None:
        return TabulatedPolicy(solution.data["u"].values[0]), policy_name(solution.inputs)
    return _clipped_gains(solution.gains, solution.problem), policy_name(solution.inputs)


def _loop_policy(run: StoredRun, problem: Problem) -> TabulatedPolicy:
    """Return the gains of a closed loop: of the phase ``policy``, or of the regulator along the last plan.

    Raises InputError for a closed loop without gains.
    """
    if "K" not in run.arrays:
        raise InputError(f"{run.path}: the closed loop has no gains to export; run it again with --phase policy")
    return _clipped_gains(Gains(run.arrays["K"], run.arrays["k"]), problem)


def _clipped_gains(gains: Gains, problem: Problem) -> TabulatedPolicy:
    """Return gains with the problem's bounds on u."""
    lower, upper = (limit.full().ravel() for limit in problem.limits(problem.parameters.values)[2:4])
    return TabulatedPolicy(gains.k, gains.K, lower, upper)


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
