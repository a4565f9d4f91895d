"""``ocp list``, ``ocp settings`` and ``ocp show``: names, settings, and one problem or file in full."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

from dynamics.laws import LAWS
from ocp.errors import choose
from ocp.problem.policy import POLICIES
from ocp.programs.solver import SOLVERS
from ocp.transcription import METHODS
from problems import describe
from problems.registry import (
    ARENA_MODULES,
    OBJECTIVE_MODULES,
    PROBLEM_MODULES,
    ROBOT_FILES,
    ObjectiveSpec,
    named,
    titles,
)
from problems.spec import ProblemSpec, Spec
from problems.tasks import registry
from reports.cli.commands import ListOptions, SettingsOptions, ShowOptions
from reports.documents.citations import full_citation
from reports.drawing.notation import plain

if TYPE_CHECKING:
    from xarray import Dataset

    from dynamics.learned.transitions import Transitions
    from problems.robots import Robot
    from reports.tables.settings import SettingGroup

_MARGIN = 21
"""Column at which summaries begin."""
Catalogue = dict[str, list[dict[str, str]]]


def check_list(options: ListOptions) -> Catalogue:
    """Return the JSON document of ``ocp list``: a mapping from kind to objects with name and summary."""
    summaries: dict[str, Callable[[], Mapping[str, str]]] = {
        "problems": lambda: titles(PROBLEM_MODULES),
        "arena": lambda: titles(ARENA_MODULES),
        "tasks": lambda: titles(registry.TASK_MODULES),
        "algorithms": _algorithms,
        "contacts": lambda: _summaries(LAWS),
        "methods": lambda: _summaries(METHODS),
        "policies": lambda: _summaries(POLICIES),
        "solvers": lambda: SOLVERS,
        "objectives": lambda: titles(OBJECTIVE_MODULES),
        "estimators": _estimators,
        "scenes": _scenes,
        "figures": _figures,
    }
    if options.kind is not None:
        summaries = {options.kind: choose("kind", options.kind, summaries)}
    return {
        kind: [{"name": name, "summary": summary} for name, summary in summary_by_name().items()]
        for kind, summary_by_name in summaries.items()
    }


def _summaries(table: Mapping[str, Any]) -> dict[str, str]:
    return {name: entry.summary for name, entry in table.items()}


def _algorithms() -> dict[str, str]:
    from ocp.learning.training import ALGORITHMS

    return _summaries(ALGORITHMS)


def _estimators() -> dict[str, str]:
    from ocp.gradients.estimators import RULES, SAMPLED

    return _summaries({**SAMPLED, **RULES})


def _scenes() -> dict[str, str]:
    from problems.gradient_scenes import SCENES

    return {name: scene.title for name, scene in SCENES.items()}


def _figures() -> dict[str, str]:
    from problems import studies

    return {name: studies.get(name).title for name in studies.ids()}


def run_list(options: ListOptions, content: Catalogue) -> int:
    """Print names and summaries of all objects, kind by kind."""
    options.output.document(content)
    if not options.as_json:
        for title, items in content.items():
            if items:
                print(title)
            for row in items:
                text = f"  {row['name']:<{_MARGIN - 3}} {row['summary']}"
                print(fill(text, 80, subsequent_indent=" " * _MARGIN, break_on_hyphens=False))
    return 0


def check_settings(options: SettingsOptions) -> list[SettingGroup]:
    """Return the groups of settings for a name, or all groups; of IPOPT's options only those that we change."""
    from reports.tables import settings

    if options.word is not None:
        return settings.find_groups(options.word)
    return [*settings.declared_groups(), settings.changed_defaults(settings.solver_group("ipopt"))]


def run_settings(options: SettingsOptions, setting_groups: list[SettingGroup]) -> int:
    """Print groups of settings, with default, range and meaning of each."""
    from reports.tables.settings import setting_line

    options.output.document({"settings": [group.row() for group in setting_groups]})
    for number, group in enumerate(() if options.as_json else setting_groups):
        if number:
            print()
        head = f"{group.name} ({group.syntax})" if group.settings else group.name
        print(fill(f"{head}: {group.summary}{'' if group.settings else '; no settings'}", 80))
        for setting in group.settings:
            print(setting_line(setting))
    return 0


def check_show(options: ShowOptions) -> Callable[[], int]:
    """Read a problem or objective, or a file of a robot, data or model; return a function that prints it."""
    from ocp.store import models

    if options.problem.lower().endswith(ROBOT_FILES):
        from problems import robots

        robot = robots.load(options.problem, floating=options.floating, planar=options.planar, folder=options.folder)
        return partial(_show_robot, options, robot)
    if not options.problem.endswith(".nc"):
        return partial(_show_spec, options, named(options.problem))
    return partial(_show_file, options, models.load_any(Path(options.problem)))


def run_show(options: ShowOptions, show: Callable[[], int]) -> int:
    """Print a problem, its learning task and best known values, or the content of a file."""
    return show()


def _show_robot(options: ShowOptions, robot: Robot) -> int:
    from reports.tables import robots
    from reports.tables.console import print_table

    content = robot.document()
    options.output.document(content)
    if options.as_json:
        return 0
    for title, table in robots.robot_tables(content):
        print(f"{title}\n")
        print_table(table)
        print()
    for line in robots.robot_notes(content):
        print(fill(line, 80, subsequent_indent="  ", break_on_hyphens=False))
    return 0


def _show_file(options: ShowOptions, dataset: Transitions | Dataset) -> int:
    from dynamics.learned.transitions import Transitions
    from reports.tables import learned_models
    from reports.tables.console import print_table

    is_transitions = isinstance(dataset, Transitions)
    content = learned_models.data_document(dataset) if is_transitions else learned_models.model_document(dataset)
    options.output.document({"file": options.problem, **content})
    if options.as_json:
        return 0
    for line in learned_models.origin_lines(content):
        print(fill(line, 80))
    for table in learned_models.document_tables(content):
        print()
        print_table(table)
    return 0


def _show_spec(options: ShowOptions, problem_spec: ProblemSpec | ObjectiveSpec) -> int:
    tasks = [registry.spec(problem_spec.name)] if problem_spec.name in registry.names() else []
    golden = {name: asdict(golden) for name, golden in problem_spec.golden.items()}
    task = _spec_document(tasks[0]) if tasks else None
    options.output.document({**_spec_document(problem_spec), "golden": golden, "task": task})
    if options.as_json:
        return 0
    print(f"{problem_spec.name}: {problem_spec.title}\n")
    _print_spec(problem_spec)
    for task in tasks:
        print(f"\nThe learning task {task.name}: {task.title}\n")
        _print_spec(task)
    return 0


def _spec_document(described_spec: Spec) -> dict[str, Any]:
    return {
        "name": described_spec.name,
        "title": described_spec.title,
        "equations": [plain(line) for line in described_spec.equations],
        "parameters": describe(described_spec),
        "citation": None if described_spec.citation is None else asdict(described_spec.citation),
    }


def _print_spec(described_spec: Spec) -> None:
    """Print equations, parameters, best known values with remarks, and the source."""
    from reports.tables.console import print_table
    from reports.tables.listings import golden_table, parameter_table

    described = _spec_document(described_spec)
    for k, line in enumerate(described["equations"], 1):
        print(fill(f"({k}) {line}", 80, initial_indent="  ", subsequent_indent="      "))
    print()
    print_table(parameter_table(described["parameters"]))
    golden = described_spec.golden if isinstance(described_spec, ProblemSpec | ObjectiveSpec) else {}
    if golden:
        print()
        print_table(golden_table(golden))
    for key, best in golden.items():
        if best.remarks:
            text = f"{key}: {best.remarks}"
            print(fill(text, 80, subsequent_indent="    ", break_on_hyphens=False))
    if described_spec.citation is not None:
        print(f"\nSource: {described_spec.citation.text} ({full_citation(described_spec.citation.key)})")
