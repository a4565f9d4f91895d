"""``ocp show PROBLEM``: what a problem is."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from textwrap import fill
from typing import TYPE_CHECKING

from reports.cli.declared import argument
from reports.cli.options import PROBLEM, Command, Options

if TYPE_CHECKING:
    from problems.objectives import ObjectiveSpec
    from problems.spec import ProblemSpec


@dataclass(frozen=True, kw_only=True)
class ShowOptions(Options):
    """What to show."""

    problem: str = argument(help=PROBLEM)


def check(options: ShowOptions) -> ProblemSpec | ObjectiveSpec:
    """Find the problem."""
    from problems.objectives import named

    return named(options.problem)


def run(options: ShowOptions, found: ProblemSpec | ObjectiveSpec) -> int:
    """Show a problem: equations, parameters with units and defaults, citation, golden values."""
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
