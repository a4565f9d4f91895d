"""``ocp list``, ``ocp laws``, ``ocp methods``, ``ocp settings``: everything that has a name."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill
from typing import Any

from dynamics.laws import LAWS
from ocp.errors import choose
from ocp.gradients.estimators import RULES, SAMPLED
from ocp.learning.training import ALGORITHMS
from ocp.policy import POLICIES
from ocp.programs.solver import SOLVERS
from ocp.transcription import METHODS
from problems import names, spec, studies
from problems.objectives import objective_names, objective_spec
from problems.tasks import registry as tasks
from reports import settings
from reports.cli.commands import LawsOptions, SettingsOptions
from reports.cli.options import Options
from reports.settings import SettingGroup

_MARGIN = 21
Catalogue = dict[str, list[dict[str, str]]]


def check_list(options: Options) -> Catalogue:
    """Return what ``ocp list --json`` prints: per kind, objects with name and summary."""
    summaries = {
        "problems": {name: spec(name).title for name in names()},
        "tasks": {name: tasks.spec(name).title for name in tasks.names()},
        "algorithms": {name: one.summary for name, one in ALGORITHMS.items()},
        "contacts": {name: one.summary for name, one in LAWS.items()},
        "methods": {name: one.summary for name, one in METHODS.items()},
        "policies": {name: one.summary for name, one in POLICIES.items()},
        "solvers": SOLVERS,
        "objectives": {name: objective_spec(name).title for name in objective_names()},
        "estimators": {name: one.summary for name, one in {**SAMPLED, **RULES}.items()},
        "figures": {name: studies.get(name).title for name in studies.ids()},
    }
    return {
        kind: [{"name": name, "summary": summary} for name, summary in found.items()]
        for kind, found in summaries.items()
    }


def run_list(options: Options, content: Catalogue) -> int:
    """Print the names and summaries."""
    options.output.document(content)
    if not options.as_json:
        for title, items in content.items():
            if items:
                print(title)
            _print_names(items)
    return 0


def _print_names(rows: Sequence[dict[str, str]]) -> None:
    """Print each name with its summary, on lines of 80 columns."""
    for row in rows:
        text = f"  {row['name']:<{_MARGIN - 3}} {row['summary']}"
        print(fill(text, 80, subsequent_indent=" " * _MARGIN, break_on_hyphens=False))


def check_settings(options: SettingsOptions) -> list[SettingGroup]:
    """Find the settings; without a name all of them, but of IPOPT only the changed defaults."""
    if options.word is not None:
        return settings.matching(options.word)
    return [*settings.groups(), settings.changed(settings.solver("ipopt"))]


def run_settings(options: SettingsOptions, found: list[SettingGroup]) -> int:
    """Print the settings."""
    return _show_groups(options, found, {"settings": [group.row() for group in found]})


def check_laws(options: LawsOptions) -> list[SettingGroup]:
    """Find the laws; raises InputError for an unknown one."""
    found = {group.name: group for group in settings.laws()}
    return [*found.values()] if options.law is None else [choose("law", options.law, found)]


def run_laws(options: LawsOptions, found: list[SettingGroup]) -> int:
    """Print the laws with their settings."""
    return _show_groups(options, found, {"laws": [group.row() for group in found]})


def check_methods(options: Options) -> list[SettingGroup]:
    """Find the settings of a solve and of the policies."""
    return [settings.solves(), *settings.policies()]


def run_methods(options: Options, found: list[SettingGroup]) -> int:
    """Print the methods, then the settings."""
    methods = [{"name": name, "summary": method.summary} for name, method in METHODS.items()]
    if not options.as_json:
        _print_names(methods)
        print()
    rows = [group.row() for group in found]
    return _show_groups(options, found, {"methods": methods, "settings": rows})


def _show_groups(options: Options, groups: Sequence[SettingGroup], document: dict[str, Any]) -> int:
    """Print each group under a heading of its own, or the document."""
    options.output.document(document)
    for number, group in enumerate(() if options.as_json else groups):
        if number:
            print()
        head = f"{group.name} ({group.syntax})" if group.settings else group.name
        print(fill(f"{head}: {group.summary}{'' if group.settings else '; no settings'}", 80))
        for setting in group.settings:
            print(settings.line(setting))
    return 0
