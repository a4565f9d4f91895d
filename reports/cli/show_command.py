"""``ocp show PROBLEM``: what a problem is."""

from __future__ import annotations

from dataclasses import asdict
from textwrap import fill
from typing import Annotated

import typer

from reports.cli.common import Debug, Json, Output, Quiet


def run(
    problem: Annotated[str, typer.Argument(help="Registered name or path/to/file.py.")],
    as_json: Json = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> int:
    """Show a problem: equations, parameters with units and defaults, citation, golden values."""
    from problems import describe
    from problems.objectives import named
    from reports.bibliography import full_citation
    from reports.notation import plain

    found = named(problem)
    parameters = describe(found)
    citation = found.citation
    equations = [plain(line) for line in found.equations]
    output = Output(as_json, quiet)
    output.document(
        {
            "name": found.name,
            "title": found.title,
            "equations": equations,
            "parameters": parameters,
            "citation": None if citation is None else asdict(citation),
            "golden": {name: asdict(golden) for name, golden in found.golden.items()},
        }
    )
    if as_json:
        return 0
    print(f"{found.name}: {found.title}\n")
    for line in equations:
        print(fill(line, 80, initial_indent="    ", subsequent_indent="        "))
    print()
    from reports.console import golden_table, parameter_table, print_table

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
