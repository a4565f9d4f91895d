"""What a person asked to be solved, checked and built: problem, law, method, policy, settings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from reports.cli.choices import assignments
from reports.cli.options import SolverOptions

if TYPE_CHECKING:
    from ocp.session import Session
    from ocp.sweeps.case import Case
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
        from problems.lent import source

        found = source(options.problem)
        given = assignments("-p", options.params)
        session = new_session(
            found, options.contact, options.method, options.policy, options.solver,
            assignments("-s", options.settings), params=given,
            contact_settings=assignments("-c", options.law_settings),
        )  # fmt: skip
        return cls(found, found.params(given).model_dump(), session)

    def check_value(self, name: str, value: float) -> None:
        """Raise InputError where parameter ``name``, the law's or the problem's, cannot be so."""
        from dynamics.systems import KNOB
        from ocp.continuation.walk import check_value

        if not name.startswith(KNOB):
            self.spec.params({**self.params, name.removeprefix("problem."): value})
        check_value(self.session, name, value)

    @property
    def origin(self) -> dict[str, Any]:
        """What a run needs to find its problem again: parameters, and a user's file."""
        source = None if self.spec.path is None else str(self.spec.path)
        return {"params": self.params, "source": source}


def case_of(options: SolverOptions) -> Case:
    """Read the words to a case that any process can build.

    A file is named by its whole path, for workers elsewhere.

    Raises :class:`~ocp.errors.InputError` for an unknown problem, and for words that are no
    assignments.
    """
    from ocp.sweeps.case import Case
    from problems.lent import source

    found = source(options.problem)
    return Case(
        options.problem if found.path is None else str(found.path),
        assignments("-p", options.params),
        options.contact,
        assignments("-c", options.law_settings),
        options.method,
        options.policy,
        options.solver,
        assignments("-s", options.settings),
    ).of(found)
