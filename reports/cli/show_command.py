"""``ocp show PROBLEM|FILE``: what a problem is, or what data and models of one hold."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

from reports.cli.options import PROBLEM, Command, Options, argument

if TYPE_CHECKING:
    from xarray import Dataset

    from dynamics.learned.transitions import Transitions
    from problems.objectives import ObjectiveSpec
    from problems.spec import ProblemSpec, Spec


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

    Where there is a task of the same name for policies to learn, that too. Of data, and of a
    model: where they come from, their ranges and scales, how well it fits.
    """
    from problems.spec import Spec

    return _named(options, found) if isinstance(found, Spec) else _file(options, found)


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


def _named(options: ShowOptions, found: ProblemSpec | ObjectiveSpec) -> int:
    from problems.tasks import registry

    tasks = [registry.spec(found.name)] if found.name in registry.names() else []
    options.output.document(
        {
            **_described(found),
            "golden": {name: asdict(golden) for name, golden in found.golden.items()},
            "task": _described(tasks[0]) if tasks else None,
        }
    )
    if options.as_json:
        return 0
    print(f"{found.name}: {found.title}\n")
    _page(found)
    _known(found)
    _source(found)
    for task in tasks:
        print(f"\nThe task {task.name}, for policies to learn: {task.title}\n")
        _page(task)
        _source(task)
    return 0


def _described(found: Spec) -> dict[str, Any]:
    from problems import describe
    from reports.notation import plain

    return {
        "name": found.name,
        "title": found.title,
        "equations": [plain(line) for line in found.equations],
        "parameters": describe(found),
        "citation": None if found.citation is None else asdict(found.citation),
    }


def _page(found: Spec) -> None:
    """Equations and parameters."""
    from reports.console import print_table
    from reports.tables import parameter_table

    described = _described(found)
    for line in described["equations"]:
        print(fill(line, 80, initial_indent="    ", subsequent_indent="        "))
    print()
    print_table(parameter_table(described["parameters"]))


def _known(found: ProblemSpec | ObjectiveSpec) -> None:
    """Best known values and what is to be said of them."""
    from reports.console import print_table
    from reports.tables import golden_table

    if found.golden:
        print()
        print_table(golden_table(found.golden))
    for key, known in found.golden.items():
        if known.remarks:
            told = f"{key}: {known.remarks}"
            print(fill(told, 80, subsequent_indent="    ", break_on_hyphens=False))


def _source(found: Spec) -> None:
    from reports.notation import full_citation

    if found.citation is not None:
        print(f"\nSource: {found.citation.text} ({full_citation(found.citation.key)})")


COMMAND = Command(
    ShowOptions,
    check,
    run,
    examples=(
        "show push-disc",
        "show data.nc",
    ),
)
