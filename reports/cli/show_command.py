"""``ocp show PROBLEM|FILE``: describe a problem, or the content of a data or model file."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from textwrap import fill
from typing import Any

from xarray import Dataset

from dynamics.learned.transitions import Transitions
from problems import describe
from problems.objectives import ObjectiveSpec, named
from problems.spec import ProblemSpec, Spec
from problems.tasks import registry
from reports.cli.commands import ShowOptions
from reports.notation import full_citation, plain


def check(options: ShowOptions) -> ProblemSpec | ObjectiveSpec | Transitions | Dataset:
    """Find the problem, or read the file."""
    from ocp.store import models

    if not options.problem.endswith(".nc"):
        return named(options.problem)
    return models.load_any(Path(options.problem))


def run(options: ShowOptions, found: ProblemSpec | ObjectiveSpec | Transitions | Dataset) -> int:
    """Show a problem: equations, parameters with units and defaults, citation, golden values."""
    return _show_spec(options, found) if isinstance(found, Spec) else _show_file(options, found)


def _show_file(options: ShowOptions, found: Transitions | Dataset) -> int:
    from reports import learned
    from reports.console import print_table

    own = isinstance(found, Transitions)
    content = learned.data_document(found) if own else learned.model_document(found)
    options.output.document({"file": options.problem, **content})
    if options.as_json:
        return 0
    for line in learned.lines(content):
        print(fill(line, 80))
    for table in learned.tables(content):
        print()
        print_table(table)
    return 0


def _show_spec(options: ShowOptions, found: ProblemSpec | ObjectiveSpec) -> int:
    tasks = [registry.spec(found.name)] if found.name in registry.names() else []
    golden = {name: asdict(golden) for name, golden in found.golden.items()}
    task = _described(tasks[0]) if tasks else None
    options.output.document({**_described(found), "golden": golden, "task": task})
    if options.as_json:
        return 0
    print(f"{found.name}: {found.title}\n")
    _page(found)
    for task in tasks:
        print(f"\nThe learning task {task.name}: {task.title}\n")
        _page(task)
    return 0


def _described(found: Spec) -> dict[str, Any]:
    return {
        "name": found.name,
        "title": found.title,
        "equations": [plain(line) for line in found.equations],
        "parameters": describe(found),
        "citation": None if found.citation is None else asdict(found.citation),
    }


def _page(found: Spec) -> None:
    """Equations, parameters, best known values with remarks on them, and the source."""
    from reports.console import print_table
    from reports.tables import golden_table, parameter_table

    described = _described(found)
    for line in described["equations"]:
        print(fill(line, 80, initial_indent="    ", subsequent_indent="        "))
    print()
    print_table(parameter_table(described["parameters"]))
    golden = found.golden if isinstance(found, ProblemSpec | ObjectiveSpec) else {}
    if golden:
        print()
        print_table(golden_table(golden))
    for key, best in golden.items():
        if best.remarks:
            text = f"{key}: {best.remarks}"
            print(fill(text, 80, subsequent_indent="    ", break_on_hyphens=False))
    if found.citation is not None:
        print(f"\nSource: {found.citation.text} ({full_citation(found.citation.key)})")
