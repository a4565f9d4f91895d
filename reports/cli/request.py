"""What a person asked for, checked and built: problem, law, method, policy, settings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ocp.errors import InputError
from reports.cli.choices import assignments, choose, contact_law, policy, split_policy_settings

if TYPE_CHECKING:
    from dynamics.contact import ContactLaw
    from ocp.policy import Policy
    from ocp.problem import Problem
    from ocp.solution import Solution
    from ocp.transcription import Method
    from problems import ProblemSpec


@dataclass(frozen=True)
class Request:
    """Everything that a solve or a continuation needs, nothing unchecked."""

    spec: ProblemSpec
    params: dict[str, Any]
    problem: Problem
    law: ContactLaw
    method: Method
    policy: Policy
    solver: str
    settings: dict[str, str]

    @classmethod
    def read(
        cls,
        *,
        problem: str,
        params: Iterable[str] | None,
        contact: str,
        law_settings: Iterable[str] | None,
        method: str,
        policy_name: str,
        solver: str,
        settings: Iterable[str] | None,
    ) -> Request:
        """Check the words of a command line; raises InputError for the first that does not fit."""
        from ocp.programs.solver import SOLVERS
        from ocp.transcription import METHODS
        from problems import parse_parameters, spec
        from problems.objectives import objective_names

        if problem in objective_names():
            raise InputError(
                f"{problem} is an objective without dynamics, nothing to solve; its gradients are"
                f" estimated: ocp estimate {problem}"
            )
        found = spec(problem)
        given = parse_parameters(found, params or ())
        law = contact_law(contact, law_settings)
        transcription = choose("method", method, METHODS)()
        choose("solver", solver, SOLVERS)
        own, others = split_policy_settings(assignments("-s", settings))
        _check_settings(others)
        chosen_policy = policy(policy_name, own)
        built = found.problem(given)
        try:
            law.knobs(built.system)
        except ValueError as error:
            raise InputError(str(error)) from error
        values = found.params(given).model_dump()
        return cls(found, values, built, law, transcription, chosen_policy, solver, others)

    def start(self, run: str, root: Path) -> Solution:
        """Return the stored solution that ``run`` names, of this problem at its own parameters.

        Raises InputError where there is none, or it is of another problem.
        """
        from ocp import store
        from reports.cli.runs_command import find
        from reports.view import problem_of

        stored = store.load(find(run, root))
        if stored.meta["problem"] != self.problem.name:
            raise InputError(
                f"--from {run}: that run is of {stored.meta['problem']}, not of"
                f" {self.problem.name}; start from a run of {self.problem.name}"
            )
        found = stored.solution(problem_of(stored)[2])
        return replace(found, record={**found.record, "hash": stored.meta["hash"]})

    def check_value(self, name: str, value: float) -> None:
        """Raise InputError where parameter ``name``, the law's or the problem's, cannot be so."""
        from dynamics.systems import KNOB

        if not name.startswith(KNOB):
            self.spec.params({**self.params, name.removeprefix("problem."): value})
            return
        try:
            self.law.at(**{name.removeprefix(KNOB): value})
        except ValueError as error:
            raise InputError(str(error)) from error

    @property
    def origin(self) -> dict[str, Any]:
        """What a run needs to find its problem again: parameters, and a user's file."""
        source = None if self.spec.path is None else str(self.spec.path)
        return {"params": self.params, "source": source}

    def described(self, solution: Solution) -> Solution:
        """Return the solution with its problem's origin in the record."""
        return replace(solution, record={**solution.record, **self.origin})


def _check_settings(settings: dict[str, str]) -> None:
    """Catch a misspelt setting of ours before the solver is asked about an option of that name."""
    from ocp.routes.relaxations import STRATEGIES
    from ocp.settings import OWN

    if "strategy" in settings:
        choose("strategy", settings["strategy"], STRATEGIES)
    for key in set(settings) - set(OWN):
        close = get_close_matches(key, OWN, n=1, cutoff=0.8)
        if close:
            raise InputError(
                f"unknown setting {key!r} (did you mean {close[0]!r}?); there are"
                f" {', '.join(OWN)}, policy.<name>, and every option of the solver"
            )


def check_pdf_place(pdf: Path | None) -> None:
    """Raise InputError before any work where a PDF could not be written after it."""
    if pdf is not None:
        check_place(pdf, "PDF")


def check_place(file: Path, what: str) -> None:
    """Raise InputError before any work where ``file``, a PDF say, could not be written after it."""
    from ocp import store

    if file.is_dir():
        ending = "pdf" if what == "PDF" else "gif"
        raise InputError(f"{file} is a directory; name a file such as {file / f'report.{ending}'}")
    try:
        store.check_writable(file.parent)
    except InputError as error:
        message = str(error).replace("the run", f"the {what}").replace("with --out", "for it")
        raise InputError(message) from error
