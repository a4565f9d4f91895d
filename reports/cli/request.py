"""From the text of a command line to checked values, and to the session that solves them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ocp.errors import InputError
from reports.cli.options import SolverOptions

if TYPE_CHECKING:
    from dynamics.contact import ContactLaw
    from dynamics.systems import ContactSystem
    from ocp.session import Session
    from ocp.sweeps.case import Case
    from problems import ProblemSpec


def assignments(option: str, given: Iterable[str] | None) -> dict[str, str]:
    """Read ``["a=1", "b=x"]``; raises InputError for anything else and for a name given twice."""
    values: dict[str, str] = {}
    for item in given or ():
        name, sign, value = (part.strip() for part in item.partition("="))
        if not (name and sign and value):
            raise InputError(f"{option}: expected name=value, got {item!r}; say {option} name=1.0")
        if name in values:
            raise InputError(f"{option}: {name} is given twice; give it once")
        values[name] = value
    return values


def contact_law(name: str, given: Iterable[str] | None) -> ContactLaw:
    """Make the law called ``name`` from what ``-c`` gave."""
    from ocp import choices

    return choices.contact_law(name, assignments("-c", given))


def closing_law(name: str, given: Iterable[str] | None, system: ContactSystem) -> ContactLaw:
    """Make a law that can close ``system``; raises InputError where it cannot."""
    from ocp import choices

    return choices.closing_law(name, assignments("-c", given), system)


def whole(option: str, text: str) -> int:
    """Read a count such as ``100000`` or ``1e5``; raises InputError for anything else."""
    from ocp.words.numbers import typed

    try:
        return typed(text, int)
    except ValueError as error:
        example = "" if "most" in str(error) else " such as 100000 or 1e5"
        raise InputError(f"{option} must be {error}{example}, got {text!r}") from None


EXAMPLES = {
    "PDF": "report.pdf",
    "C file": "rollout.c",
    "data": "data.nc",
    "model": "model.nc",
    "figure": "figure.pdf",
}


def check_places(out: Path, pdf: Path | None) -> None:
    """Raise InputError where runs could not be stored in ``out`` or a report written to ``pdf``."""
    from ocp import store

    store.check_writable(out)
    if pdf is not None:
        check_place(pdf, "PDF")


def check_place(file: Path, what: str) -> None:
    """Raise InputError where ``file``, a PDF say, could not be written."""
    from ocp import store
    from ocp.store import atomic

    if file.is_dir():
        example = EXAMPLES.get(what, "report.gif")
        raise InputError(f"{file} is a directory; name a file such as {file / example}")
    with atomic.told(f"the {what} to {file}"):
        place = atomic.destination(file)
    if place is None:
        return
    try:
        store.check_writable(place.parent)
    except InputError as error:
        message = str(error).replace("the run", f"the {what}").replace("with --out", "for it")
        raise InputError(message) from error


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
        from problems.plugin import source

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
    from problems.plugin import source

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
