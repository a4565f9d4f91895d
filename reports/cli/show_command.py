"""``ocp show PROBLEM|FILE``: describe a problem, or the content of a data or model file."""

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
    """The problem or the file."""

    problem: str = argument(
        metavar="PROBLEM|FILE", help=f"{PROBLEM[:-1]}, or a .nc file of ocp collect or ocp learn."
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

    A learning task of the same name is shown too. For data and models: origin, ranges, scales, and
    the quality of the fit.
    """
    from problems.spec import Spec

    return _show_spec(options, found) if isinstance(found, Spec) else _show_file(options, found)


def _show_file(options: ShowOptions, found: Transitions | Dataset) -> int:
    from reports import learned
    from reports.console import print_table

    content = learned.describe(found)
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
    _golden(found)
    _source(found)
    for task in tasks:
        print(f"\nThe learning task {task.name}: {task.title}\n")
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


def _golden(found: ProblemSpec | ObjectiveSpec) -> None:
    """Best known values and remarks on them."""
    from reports.console import print_table
    from reports.tables import golden_table

    if found.golden:
        print()
        print_table(golden_table(found.golden))
    for key, best in found.golden.items():
        if best.remarks:
            print(
                fill(f"{key}: {best.remarks}", 80, subsequent_indent="    ", break_on_hyphens=False)
            )


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
