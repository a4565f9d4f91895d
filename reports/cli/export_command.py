"""``ocp export RUN|PROBLEM -o FILE.c``: step, derivatives and policy as one freestanding C file."""

from __future__ import annotations

from dataclasses import MISSING, dataclass, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from reports.cli.options import Command, SourceOptions, argument, option

if TYPE_CHECKING:
    import numpy as np

    from dynamics.batch import TabulatedPolicy
    from dynamics.contact import ContactLaw, Step
    from ocp.problem import Problem
    from ocp.solution import Solution


@dataclass(frozen=True, kw_only=True)
class ExportOptions(SourceOptions):
    """The run or problem, the file, and the law if it is not the run's own."""

    what: str = argument(
        metavar="RUN|PROBLEM",
        help="A run: its path, or part of its name; or a problem: its name or file.",
    )
    file: Path = option(MISSING, "--output", "-o", help="The C file to write.")
    params: list[str] | None = option(
        None, "--param", "-p", metavar="K=V", help="Parameter of the problem."
    )
    contact: str | None = option(
        None, "--contact", help="Contact law; default: that of the run, or barrier."
    )
    law_settings: list[str] | None = option(
        None, "--contact-setting", "-c", metavar="K=V", help="Setting of the contact law."
    )

    @property
    def named_runs(self) -> list[str]:
        """Runs that the command reads, as given."""
        return [] if self.is_problem else [self.what]

    @property
    def is_problem(self) -> bool:
        """Whether the argument is a problem, by its name or its file."""
        from problems import names

        return self.what in names() or self.what.endswith(".py")


@dataclass(frozen=True)
class ExportRequest:
    """A problem's step under a law, and the policy of a run, if there is one."""

    name: str
    title: str
    problem: Problem
    law: ContactLaw
    solution: Solution | None = None
    run: str | None = None

    @property
    def policy_name(self) -> str | None:
        """``open-loop`` or ``feedback``; None for a problem."""
        if self.solution is None:
            return None
        return "open-loop" if self.solution.gains is None else "feedback"

    @cached_property
    def step(self) -> Step:
        """The closed step."""
        return self.law.close(self.problem.system)

    @property
    def values(self) -> np.ndarray:
        """Values of the step's parameters."""
        from ocp.rollout import step_values

        defaults = self.problem.parameters.defaults
        return step_values(self.problem, self.step, defaults, own=False)

    @property
    def policy(self) -> TabulatedPolicy | None:
        """The run's inputs, or its gains within the bounds on u."""
        from dynamics.batch import TabulatedPolicy

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
        """The first lines of the file."""
        settings = ", ".join(f"{key} = {value}" for key, value in self.law.settings().items())
        law = f"contact law: {self.law.name}" + (f" ({settings})" if settings else "")
        policy = [] if self.run is None else [f"policy: {self.policy_name}, of the run {self.run}"]
        wrote = f"written by ocp export, centralpath {version('centralpath')}"
        return [f"{self.name}: {self.title}", law, *policy, wrote]


def check(options: ExportOptions) -> ExportRequest:
    """Find the step and policy; raises InputError for a law without C code."""
    from dynamics.contact.learned_step import LearnedStep
    from ocp.errors import InputError

    request = _find(options)
    if isinstance(request.step, LearnedStep):
        raise InputError(
            f"contact law {request.law.name}: a learned step cannot be exported to C; choose"
            " another law with --contact"
        )
    return request


def _find(options: ExportOptions) -> ExportRequest:
    """Find the problem or the run, and make the law."""
    from ocp.errors import InputError
    from problems import spec
    from reports.cli.request import assignments, check_place, closing_law

    check_place(options.file, "C file")
    what = options.what
    if options.is_problem:
        if "out" in options.given:
            raise InputError(f"--out is for a run, but {what} is a problem; drop it")
        if options.source is not None:
            raise InputError(f"--source is for a run, but {what} is a problem; drop it")
        found = spec(what)
        problem = found.problem(assignments("-p", options.params))
        law = closing_law(options.contact or "barrier", options.law_settings, problem.system)
        return ExportRequest(found.name, found.title, problem, law)
    request = _read_run(what, options)
    if options.params:
        raise InputError(
            f"-p: a run has fixed parameters; to choose them export the problem {request.name}"
        )
    if options.contact is None and not options.law_settings:
        return request
    name, system = options.contact or request.law.name, request.problem.system
    return replace(request, law=closing_law(name, options.law_settings, system))


def _read_run(what: str, options: ExportOptions) -> ExportRequest:
    """Read a run; raises InputError, with the closest name, where there is none."""
    from ocp.errors import InputError, did_you_mean
    from problems import names
    from problems.objectives import objective_names
    from problems.plugin import problem_of
    from reports.cli.request import closing_law
    from reports.cli.runs_command import stored

    if what in objective_names():
        raise InputError(f"{what} is an objective without dynamics and has no step to export")
    try:
        run = stored(what, options.out)
    except InputError as error:
        hint = did_you_mean(what, names())
        raise InputError(f"{error}; it is no problem's name either{hint}") from error
    found, _, problem = problem_of(run, options.own([run]))
    solution = run.solution(problem)
    settings = [f"{key}={value}" for key, value in run.record["contact_settings"].items()]
    law = closing_law(run.record["contact"], settings, problem.system)
    return ExportRequest(found.name, found.title, problem, law, solution, run.path.name)


def run(options: ExportOptions, request: ExportRequest) -> int:
    """Write one step of a problem, its derivatives and a run's policy as one C11 file."""
    from dynamics.batch import exported, identifier
    from ocp.store import atomic

    text = exported(request.step, request.values, request.name, request.about, request.policy)
    content = text.encode()
    atomic.write(options.file, content, "the C file")
    name = identifier(request.name)
    functions = [f"{name}_step", f"{name}_derivatives"]
    if request.policy is not None:
        functions.append(f"{name}_policy")
    options.output.say(f"C file: {options.file} ({', '.join(functions)})")
    options.output.document(
        {
            "file": str(options.file),
            "problem": request.name,
            "contact": request.law.name,
            "contact_settings": request.law.settings(),
            "run": request.run,
            "policy": request.policy_name,
            "functions": functions,
            "bytes": len(content),
        }
    )
    return 0


COMMAND = Command(
    ExportOptions,
    check,
    run,
    examples=(
        "export push-disc --contact barrier -c mu=1e-3 -o step.c",
        "export @last -o policy.c",
    ),
)
