"""What a person asked to be solved, checked and built: problem, law, method, policy, settings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from ocp.errors import InputError, choose, did_you_mean
from reports.cli.choices import assignments, closing_law, policy, split_policy_settings
from reports.cli.options import SolverOptions

if TYPE_CHECKING:
    from ocp.session import Session
    from ocp.solution import Solution
    from problems import ProblemSpec


@dataclass(frozen=True)
class Request:
    """A problem's spec, its parameters, and the session that is to solve it."""

    spec: ProblemSpec
    params: dict[str, Any]
    session: Session

    @classmethod
    def read(cls, options: SolverOptions) -> Request:
        """Check the words of a command line; raises InputError for the first that does not fit."""
        from ocp.solve import new_session
        from ocp.transcription import METHODS
        from problems import spec
        from problems.objectives import objective_names

        if options.problem in objective_names():
            raise InputError(
                f"{options.problem} is an objective without dynamics, nothing to solve; its"
                f" gradients are estimated: ocp estimate {options.problem}"
            )
        found = spec(options.problem)
        given = assignments("-p", options.params)
        method = choose("method", options.method, METHODS)()
        own, settings = split_policy_settings(assignments("-s", options.settings))
        _check_spelling(settings, options.solver)
        chosen = policy(options.policy, own)
        problem = found.problem(given)
        law = closing_law(options.contact, options.law_settings, problem.system)
        session = new_session(problem, law, method, chosen, options.solver, settings)
        return cls(found, found.params(given).model_dump(), session)

    def check_value(self, name: str, value: float) -> None:
        """Raise InputError where parameter ``name``, the law's or the problem's, cannot be so."""
        from dynamics.systems import KNOB

        if not name.startswith(KNOB):
            self.spec.params({**self.params, name.removeprefix("problem."): value})
            return
        try:
            self.session.law.at(**{name.removeprefix(KNOB): value})
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


def _check_spelling(settings: dict[str, str], solver: str) -> None:
    """Refuse a setting that is neither ours nor an option of the solver."""
    from ocp.programs.options import documented, has_option
    from ocp.programs.solver import SOLVERS
    from ocp.settings import OWN

    choose("solver", solver, SOLVERS)
    for key in sorted(set(settings) - set(OWN)):
        bare = key.removeprefix("ipopt.")
        if not has_option(solver, bare):
            known = [*OWN, *documented(solver)]
            raise InputError(
                f"unknown setting {key!r}{did_you_mean(bare, known, 0.6)}; there are"
                f" {', '.join(OWN)}, policy.<name>, and the options of {solver}: ocp settings and"
                f" ocp settings {solver} tell them"
            )
