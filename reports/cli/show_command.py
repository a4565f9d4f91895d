"""``ocp show PROBLEM|FILE``: what a problem is, or what data and models of one hold."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING

from reports.cli.declared import argument
from reports.cli.options import PROBLEM, Command, Options

if TYPE_CHECKING:
    from xarray import Dataset

    from dynamics.learned.transitions import Transitions
    from problems.objectives import ObjectiveSpec
    from problems.spec import ProblemSpec


@dataclass(frozen=True, kw_only=True)
class ShowOptions(Options):
    """What to show."""

    problem: str = argument(
        metavar="PROBLEM|FILE", help=f"{PROBLEM[:-1]}, or a .nc of ocp collect or ocp learn."
    )


def check(options: ShowOptions) -> ProblemSpec | ObjectiveSpec | Transitions | Dataset:
    """Find the problem, or read the file."""
    from ocp.store import models
    from problems.objectives import named

    if not options.problem.endswith(".nc"):
        return named(options.problem)
    return models.load_any(Path(options.problem))


def run(options: ShowOptions, found: ProblemSpec | ObjectiveSpec | Transitions | Dataset) -> int:
    """Show a problem: equations, parameters with units and defaults, citation, golden values.

    Of data, and of a model: where they come from, their ranges and scales, how well it fits.
    """
    from problems.spec import Spec

    return _problem(options, found) if isinstance(found, Spec) else _file(options, found)


def _file(options: ShowOptions, found: Transitions | Dataset) -> int:
    from reports import learned
    from reports.console import print_table

    told = learned.document(found)
    options.output.document({"file": options.problem, **told})
    if options.as_json:
        return 0
    for line in learned.lines(told):
        print(fill(line, 80))
    for table in learned.tables(told):
        print()
        print_table(table)
    return 0


def _problem(options: ShowOptions, found: ProblemSpec | ObjectiveSpec) -> int:
    from problems import describe
    from reports.bibliography import full_citation
    from reports.notation import plain

    parameters = describe(found)
    citation = found.citation
    equations = [plain(line) for line in found.equations]
    options.output.document(
        {
            "name": found.name,
            "title": found.title,
            "equations": equations,
            "parameters": parameters,
            "citation": None if citation is None else asdict(citation),
            "golden": {name: asdict(golden) for name, golden in found.golden.items()},
        }
    )
    if options.as_json:
        return 0
    print(f"{found.name}: {found.title}\n")
    for line in equations:
        print(fill(line, 80, initial_indent="    ", subsequent_indent="        "))
    print()
    from reports.console import print_table
    from reports.stored_tables import golden_table, parameter_table

    print_table(parameter_table(parameters))
    if found.golden:
        print()
        print_table(golden_table(found.golden))
    for key, known in found.golden.items():
        if known.remarks:
            told = f"{key}: {known.remarks}"
            print(fill(told, 80, subsequent_indent="    ", break_on_hyphens=False))
    if citation is not None:
        print(f"\nSource: {citation.text} ({full_citation(citation.key)})")
    return 0


COMMAND = Command(ShowOptions, check, run)
