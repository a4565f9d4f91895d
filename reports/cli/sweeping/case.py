"""From the words of a command line to a case that any process can build."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ocp.sweeps.case import Case
from problems.lent import source
from reports.cli.choices import assignments

if TYPE_CHECKING:
    from reports.cli.options import SolverOptions


def case_of(options: SolverOptions) -> Case:
    """Read the words; a file is named by its whole path, for workers elsewhere.

    Raises :class:`~ocp.errors.InputError` for an unknown problem, and for words that are no
    assignments.
    """
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
