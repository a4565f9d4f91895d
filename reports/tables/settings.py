"""All settings, collected from their declarations: laws, solves, policies, solvers, training."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from textwrap import fill
from typing import Any

from dynamics.laws import LAWS
from dynamics.settings import Setting, settings_of
from ocp.errors import InputError, did_you_mean
from ocp.gradients.estimators import RULES
from ocp.learning.experiment import Experiment
from ocp.learning.psi_learning import PsiLearning
from ocp.learning.training import ALGORITHMS
from ocp.problem.policy import POLICIES
from ocp.programs.options import documented
from ocp.programs.solver import IPOPT_DEFAULTS, SOLVERS
from ocp.routes.relaxations import STRATEGY_USES
from ocp.search.random_search import RandomSearch
from ocp.solve.request import Settings
from ocp.transcription import METHODS
from ocp.transcription.factories import law_class


@dataclass(frozen=True)
class SettingRow:
    """Row of a setting in ``ocp settings``; ``range`` describes its values, and ``default`` is None if it has none."""

    name: str
    kind: str
    default: Any
    meaning: str
    unit: str = "1"
    range: str = ""


def setting_rows(cls: type) -> list[SettingRow]:
    """Return the settings of a class with a declared meaning; users can set only these."""
    return [setting_row(setting) for setting in settings_of(cls).values() if setting.meaning]


def setting_row(setting: Setting) -> SettingRow:
    """Return the row of ``ocp settings`` for a declared setting."""
    return SettingRow(
        setting.name, setting.kind, setting.default, setting.meaning, setting.unit, setting.range.removeprefix("a ")
    )


@dataclass(frozen=True)
class SettingGroup:
    """Settings of one object: its name, the syntax of a setting, and a summary of the object."""

    name: str
    syntax: str
    summary: str
    settings: list[SettingRow]

    def row(self) -> dict[str, Any]:
        """Return the group as a dictionary for JSON."""
        return {**vars(self), "settings": [vars(setting) for setting in self.settings]}


def law_groups() -> list[SettingGroup]:
    """Return a group per contact law, with the settings of ``-c``."""
    return _groups(LAWS, "-c NAME=VALUE")


def law_group(name: str) -> SettingGroup:
    """Return the settings of the law in a user's file; the meaning of undeclared settings is empty."""
    cls = law_class(name)
    return SettingGroup(cls.name, "-c NAME=VALUE", cls.summary, [*map(setting_row, settings_of(cls).values())])


def method_groups() -> list[SettingGroup]:
    """Return groups of transcription methods, settings of a solve, strategies and policies."""
    method_settings = [SettingRow(name, "", None, method.summary) for name, method in METHODS.items()]
    summary = "how a problem becomes a program"
    strategy_settings = [SettingRow(name, "", None, meaning) for name, meaning in STRATEGY_USES.items()]
    uses = "strategies of the direct method under the exact law, and their uses"
    return [
        SettingGroup("methods", "--method NAME", summary, method_settings),
        SettingGroup("solve", "-s NAME=VALUE", "method, homotopy and solver of a solve", setting_rows(Settings)),
        SettingGroup("strategies", "-s strategy=NAME", uses, strategy_settings),
        *_groups(POLICIES, "-s policy.NAME=VALUE"),
    ]


def estimator_groups() -> list[SettingGroup]:
    """Return a group, with its settings in ``ocp estimate``, for each estimator that mixes zeroth and first order."""
    return _groups(RULES, "-s {}.NAME=VALUE")


def _groups(table: Mapping[str, Any], syntax: str) -> list[SettingGroup]:
    """Return a group per class of a table; the name of the class replaces ``{}`` in the syntax."""
    return [SettingGroup(name, syntax.format(name), cls.summary, setting_rows(cls)) for name, cls in table.items()]


def training_groups() -> list[SettingGroup]:
    """Return groups of settings of ``ocp train``: shared by all algorithms, of psi, and of each algorithm."""
    psi = SettingGroup(
        "psi",
        "-s psi=NAMES, and -s psi.NAME=VALUE",
        "physical parameters NAMES, learned with the policy; psi.NAME is an initial value",
        [*setting_rows(PsiLearning), *setting_rows(RandomSearch)],
    )
    shared_group = SettingGroup(
        "train", "-s NAME=VALUE", "settings of all algorithms of ocp train", setting_rows(Experiment)
    )
    return [shared_group, psi, *_groups(ALGORITHMS, "-s {}.NAME=VALUE")]


def solver_group(name: str) -> SettingGroup:
    """Return the options of a solver, from its documentation, with our defaults."""
    own_defaults: dict[str, Any] = IPOPT_DEFAULTS if name == "ipopt" else {}
    option_settings = [
        replace(setting_row(option), default=own_defaults.get(key, option.extra("documented_default", "")))
        for key, option in documented(name).items()
    ]
    return SettingGroup(name, "-s NAME=VALUE", SOLVERS[name], option_settings)


def declared_groups() -> list[SettingGroup]:
    """Return all settings except the options of solvers."""
    return [group for kind in _groups_by_kind().values() for group in kind]


def _groups_by_kind() -> dict[str, list[SettingGroup]]:
    """Return a mapping from words that ``ocp settings`` accepts, such as ``laws``, to groups of settings."""
    return {
        "methods": method_groups(),
        "laws": law_groups(),
        "estimators": estimator_groups(),
        "training": training_groups(),
    }


def changed_defaults(group: SettingGroup) -> SettingGroup:
    """Return the options of a solver whose default in the workbench differs from the solver's default."""
    solver_options = documented(group.name)
    changed_settings = [
        setting
        for setting in group.settings
        if default_text(setting.default) != solver_options[setting.name].extra("documented_default", "")
    ]
    return replace(group, settings=changed_settings)


def find_groups(word: str) -> list[SettingGroup]:
    """Return the groups of a kind, the group called ``word``, or all settings with this name.

    For the name of a ``*.py`` file, the group is that of the contact law in this file. Raises
    :class:`~ocp.errors.InputError` for an unknown name.
    """
    if word.endswith(".py"):
        return [law_group(word)]
    kinds = _groups_by_kind()
    if word in kinds:
        return kinds[word]
    if word in SOLVERS:
        return [solver_group(word)]
    named = {group.name: group for groups in kinds.values() for group in groups}
    if word in named:
        return [named[word]]
    all_groups = [*named.values(), *map(solver_group, SOLVERS)]
    setting_name = word.rpartition(".")[2]
    matching_groups = [
        replace(group, settings=[setting for setting in group.settings if setting.name == setting_name])
        for group in all_groups
    ]
    if not any(group.settings for group in matching_groups):
        group_names = list(dict.fromkeys([*kinds, *named, *SOLVERS]))
        choices = [*group_names, *(setting.name for group in all_groups for setting in group.settings)]
        raise InputError(f"unknown name {word!r}{did_you_mean(word, choices)}; groups: {', '.join(group_names)}")
    return [group for group in matching_groups if group.settings]


def setting_line(setting: SettingRow) -> str:
    """Return ``NAME=DEFAULT``, range and meaning of a setting, wrapped at 80 columns."""
    default = default_text(setting.default)
    text = f"{setting.name}={default}" if default else setting.name
    kind = f" ({setting.range or setting.kind})" if setting.kind else ""
    return fill(
        f"{text}{kind}: {setting.meaning}".rstrip(": "),
        80,
        initial_indent="  ",
        subsequent_indent="      ",
        break_on_hyphens=False,
    )


def default_text(value: Any) -> str:
    """Return a default value in the syntax of the command line; "" for None."""
    if value is None or isinstance(value, bool):
        return "" if value is None else str(value).lower()
    if isinstance(value, tuple):
        return ",".join(map(str, value)) or "affine"
    return f"{value:g}" if isinstance(value, float) else str(value)
