"""``ocp export RUN|PROBLEM -o FILE.c``: step, derivatives and policy as one freestanding C file."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from reports.cli.options import Command, StoreOptions

if TYPE_CHECKING:
    import numpy as np

    from dynamics.batch import TabulatedPolicy
    from dynamics.contact import ContactLaw, Step
    from ocp.problem import Problem
    from ocp.solution import Solution


@dataclass(frozen=True, kw_only=True)
class ExportOptions(StoreOptions):
    """What to write, under which law, and where."""

    what: Annotated[
        str,
        typer.Argument(
            metavar="RUN|PROBLEM",
            help="A run: its path, or part of its name; or a problem: its name or file.",
        ),
    ]
    file: Annotated[Path, typer.Option("--output", "-o", help="The C file to write.")]
    params: Annotated[
        list[str] | None,
        typer.Option("--param", "-p", metavar="K=V", help="Parameter of the problem."),
    ] = None
    contact: Annotated[
        str | None,
        typer.Option("--contact", help="Contact law; a run's own or barrier if not said."),
    ] = None
    law_settings: Annotated[
        list[str] | None,
        typer.Option("--contact-setting", "-c", metavar="K=V", help="Setting of the contact law."),
    ] = None


@dataclass(frozen=True)
class Asked:
    """What is written: a problem's step under a law, and the policy of a run, if it is one."""

    name: str
    title: str
    problem: Problem
    law: ContactLaw
    solution: Solution | None = None
    run: str | None = None

    @property
    def acts(self) -> str | None:
        """What the run decided: ``open-loop`` inputs or ``feedback``; None of a problem."""
        if self.solution is None:
            return None
        return "open-loop" if self.solution.gains is None else "feedback"

    @property
    def step(self) -> Step:
        """The closed step; raises InputError where the law cannot take the system."""
        from ocp.errors import InputError

        try:
            return self.law.close(self.problem.system)
        except ValueError as error:
            raise InputError(str(error)) from error

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
        policy = [] if self.run is None else [f"policy: {self.acts}, of the run {self.run}"]
        wrote = f"written by ocp export, centralpath {version('centralpath')}"
        return [f"{self.name}: {self.title}", law, *policy, wrote]


def read(
    what: str,
    params: Iterable[str] | None,
    contact: str | None,
    law_settings: Iterable[str] | None,
    root: Path,
) -> Asked:
    """Find the problem or the run that ``what`` names, and the law.

    Raises InputError for what is neither, and for parameters given to a run, which has its own.
    """
    from ocp.errors import InputError
    from problems import names, spec
    from reports.cli.choices import assignments, contact_law

    if what in names() or (what.endswith(".py") and not Path(what).is_dir()):
        found = spec(what)
        problem = found.problem(assignments("-p", params))
        law = contact_law(contact or "barrier", law_settings)
        return Asked(found.name, found.title, problem, law)
    asked = _run(what, root)
    if params:
        raise InputError(f"-p: a run has its parameters; to choose them export {asked.name}")
    if contact is None and not law_settings:
        return asked
    law = contact_law(contact or asked.law.name, law_settings)
    return Asked(asked.name, asked.title, asked.problem, law, asked.solution, asked.run)


def _run(what: str, root: Path) -> Asked:
    """Read a run; raises InputError where nothing has that name, saying what has."""
    from ocp import store
    from ocp.errors import InputError, did_you_mean
    from problems import names
    from problems.objectives import objective_names
    from reports.cli.choices import contact_law
    from reports.cli.runs_command import find
    from reports.view import problem_of

    if what in objective_names():
        raise InputError(f"{what} is an objective without dynamics: there is no step to export")
    hint = did_you_mean(what, names())
    try:
        stored = store.load(find(what, root))
    except InputError as error:
        raise InputError(f"{error}; nor is there a problem {what!r}{hint}") from error
    found, _, problem = problem_of(stored)
    solution = stored.solution(problem)
    settings: dict[str, Any] = stored.record["contact_settings"]
    law = contact_law(stored.record["contact"], [f"{k}={v}" for k, v in settings.items()])
    return Asked(found.name, found.title, problem, law, solution, stored.path.name)


def check(options: ExportOptions) -> Asked:
    """Find the run or the problem, and the law that closes it."""
    from reports.cli.places import check_place

    check_place(options.file, "C file")
    asked = read(options.what, options.params, options.contact, options.law_settings, options.out)
    assert asked.step is not None
    return asked


def run(options: ExportOptions, found: Asked) -> int:
    """Write one step of a problem, its derivatives and a run's policy as one C11 file."""
    from dynamics.batch import exported, identifier
    from ocp.store import atomic

    file = options.file
    text = exported(found.step, found.values, found.name, found.about, found.policy)
    content = text.encode()
    atomic.write(file, content, "the C file")
    name = identifier(found.name)
    functions = [f"{name}_step", f"{name}_derivatives"]
    if found.policy is not None:
        functions.append(f"{name}_policy")
    output = options.output
    output.say(f"C file: {file} ({', '.join(functions)})")
    output.document(
        {
            "file": str(file),
            "problem": found.name,
            "contact": found.law.name,
            "contact_settings": found.law.settings(),
            "run": found.run,
            "policy": found.acts,
            "functions": functions,
            "bytes": len(content),
        }
    )
    return 0


COMMAND = Command(ExportOptions, check, run)
