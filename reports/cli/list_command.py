"""``ocp list``, ``ocp laws``, ``ocp methods``, ``ocp settings``: everything that has a name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import fill
from typing import TYPE_CHECKING, Any

from reports.cli.options import Command, Options, argument

if TYPE_CHECKING:
    from reports.settings import SettingGroup

_MARGIN = 21
Catalogue = dict[str, list[dict[str, Any]]]
Methods = tuple[list[dict[str, Any]], "list[SettingGroup]"]


def catalogue(options: Options) -> Catalogue:
    """Return what ``ocp list --json`` prints: per kind, objects with name and summary."""
    from dynamics.laws import LAWS
    from ocp.gradients.estimators import SAMPLED
    from ocp.gradients.interpolation import RULES
    from ocp.learning.algorithms import ALGORITHMS
    from ocp.policy import POLICIES
    from ocp.programs.solver import SOLVERS
    from ocp.transcription import METHODS
    from problems import names, spec, studies
    from problems.objectives import objective_names, objective_spec
    from problems.tasks import registry as tasks

    def classes(table: Any) -> list[dict[str, Any]]:
        return [{"name": name, "summary": table[name].summary} for name in table]

    return {
        "problems": [{"name": name, "summary": spec(name).title} for name in names()],
        "tasks": [{"name": name, "summary": tasks.spec(name).title} for name in tasks.names()],
        "algorithms": classes(ALGORITHMS),
        "contacts": classes(LAWS),
        "methods": classes(METHODS),
        "policies": classes(POLICIES),
        "solvers": [{"name": name, "summary": SOLVERS[name]} for name in SOLVERS],
        "objectives": [
            {"name": name, "summary": objective_spec(name).title} for name in objective_names()
        ],
        "estimators": classes({**SAMPLED, **RULES}),
        "figures": [{"name": i, "summary": studies.get(i).title} for i in studies.ids()],
    }


def run_list(options: Options, content: Catalogue) -> int:
    """List named problems, tasks, algorithms, contact laws, methods, policies, solvers, figures."""
    options.output.document(content)
    if not options.as_json:
        for title, items in content.items():
            if items:
                print(title)
            _print_names(items)
    return 0


def _print_names(rows: Sequence[dict[str, Any]]) -> None:
    """Print each name with its summary, on lines of 80 columns."""
    for row in rows:
        text = f"  {row['name']:<{_MARGIN - 3}} {row['summary']}"
        print(fill(text, 80, subsequent_indent=" " * _MARGIN, break_on_hyphens=False))


@dataclass(frozen=True, kw_only=True)
class SettingsOptions(Options):
    """Whose settings, or which setting."""

    word: str | None = argument(
        default=None,
        help="A law, policy, solver, estimator or algorithm, or the name of a setting.",
    )


def find_settings(options: SettingsOptions) -> list[SettingGroup]:
    """Find the settings; without a name all of them, but of IPOPT only the changed defaults."""
    from reports import settings

    if options.word is not None:
        return settings.matching(options.word)
    return [*settings.groups(), settings.changed(settings.solver("ipopt"))]


def run_settings(options: SettingsOptions, found: list[SettingGroup]) -> int:
    """List every setting of -s and -c: default, value, meaning.

    IPOPT's options are listed where our default differs from IPOPT's; ocp settings ipopt has all.
    """
    options.output.document({"settings": [group.row() for group in found]})
    if not options.as_json:
        _print_settings(found)
    return 0


@dataclass(frozen=True, kw_only=True)
class LawsOptions(Options):
    """One law, or all."""

    law: str | None = argument(default=None, help="One law; default: all.")


def find_laws(options: LawsOptions) -> list[SettingGroup]:
    """Find the laws; raises InputError for an unknown one."""
    from ocp.errors import choose
    from reports import settings

    found = {group.name: group for group in settings.laws()}
    return [*found.values()] if options.law is None else [choose("law", options.law, found)]


def run_laws(options: LawsOptions, found: list[SettingGroup]) -> int:
    """List the contact laws with every setting of -c: default, value, meaning."""
    options.output.document({"laws": [group.row() for group in found]})
    if not options.as_json:
        _print_settings(found)
    return 0


def find_methods(options: Options) -> Methods:
    """Find the methods, and the settings of a solve and of the policies."""
    from reports import settings

    return [dict(row) for row in settings.methods()], [settings.solves(), *settings.policies()]


def run_methods(options: Options, found: Methods) -> int:
    """List the methods and policies of ocp solve, with every setting of -s that they take."""
    methods, groups = found
    settings = [group.row() for group in groups]
    options.output.document({"methods": methods, "settings": settings})
    if not options.as_json:
        _print_names(methods)
        print()
        _print_settings(groups)
    return 0


def _print_settings(groups: Sequence[SettingGroup]) -> None:
    """Print each group under a heading of its own."""
    from reports.settings import line

    for number, group in enumerate(groups):
        if number:
            print()
        head = f"{group.name} ({group.syntax})" if group.settings else group.name
        print(fill(f"{head}: {group.summary}{'' if group.settings else '; no settings'}", 80))
        for setting in group.settings:
            print(line(setting))


LIST = Command(Options, catalogue, run_list, examples=("list", "list --json"))
LAWS = Command(LawsOptions, find_laws, run_laws, examples=("laws", "laws adaptive", "laws --json"))
METHODS = Command(Options, find_methods, run_methods, examples=("methods", "methods --json"))
SETTINGS = Command(
    SettingsOptions, find_settings, run_settings,
    examples=("settings", "settings ipopt", "settings fopg", "settings tol"),
)  # fmt: skip
