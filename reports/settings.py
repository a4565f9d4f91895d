"""Every setting, collected from its declaration: laws, solves, policies, solvers, training."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from inspect import signature
from textwrap import fill
from typing import Any

from dynamics.laws import LAWS
from ocp.errors import InputError, did_you_mean
from ocp.gradients.estimators import RULES
from ocp.learning.experiment import Experiment
from ocp.learning.psi_learning import PsiLearning
from ocp.learning.random_search import RandomSearch
from ocp.learning.training import ALGORITHMS
from ocp.problem.policy import POLICIES
from ocp.programs.options import documented
from ocp.programs.solver import IPOPT_DEFAULTS, SOLVERS
from ocp.routes.relaxations import STRATEGY_USES
from ocp.solve.request import Setting, Settings, declared
from ocp.transcription import METHODS
from ocp.transcription.factories import law_class


@dataclass(frozen=True)
class SettingGroup:
    """Settings of one object: its name, the syntax of a setting, and what the object is."""

    name: str
    syntax: str
    summary: str
    settings: list[Setting]

    def row(self) -> dict[str, Any]:
        """As JSON has it."""
        return {**vars(self), "settings": [vars(setting) for setting in self.settings]}


def laws() -> list[SettingGroup]:
    """Contact laws with the settings that ``-c`` takes."""
    return _groups(LAWS, "-c NAME=VALUE")


def law(name: str) -> SettingGroup:
    """The settings of a law of a user's file; one that is not declared has no meaning here."""
    cls = law_class(name)
    plain = {
        key: Setting(key, "value", None if one.default is one.empty else one.default, "")
        for key, one in signature(cls).parameters.items()
    }
    known = plain | {one.name: one for one in declared(cls)}
    return SettingGroup(cls.name, "-c NAME=VALUE", cls.summary, [*known.values()])


def methods() -> list[SettingGroup]:
    """Methods, settings of a solve, strategies and policies."""
    found = [Setting(name, "", None, method.summary) for name, method in METHODS.items()]
    about = "how a problem becomes a program"
    return [SettingGroup("methods", "--method NAME", about, found), solves(), strategies(), *policies()]


def strategies() -> SettingGroup:
    """Strategies of exact complementarity, and what each is for."""
    about = "which for what, of the direct method under the exact law"
    found = [Setting(name, "", None, meaning) for name, meaning in STRATEGY_USES.items()]
    return SettingGroup("strategies", "-s strategy=NAME", about, found)


def solves() -> SettingGroup:
    """Our own settings of a solve."""
    about = "method, homotopy and solver of a solve"
    return SettingGroup("solve", "-s NAME=VALUE", about, declared(Settings))


def policies() -> list[SettingGroup]:
    """Policies with their settings."""
    return _groups(POLICIES, "-s policy.NAME=VALUE")


def estimators() -> list[SettingGroup]:
    """Estimators that mix two orders, with the settings of ``ocp estimate``."""
    return _groups(RULES, "-s {}.NAME=VALUE")


def _groups(table: Mapping[str, Any], syntax: str) -> list[SettingGroup]:
    """A group for each class of a table; ``{}`` in the syntax stands for its name."""
    return [SettingGroup(name, syntax.format(name), cls.summary, declared(cls)) for name, cls in table.items()]


def training() -> list[SettingGroup]:
    """Settings of ``ocp train``: of all algorithms, and of each."""
    psi = SettingGroup(
        "psi",
        "-s psi=NAMES, and -s psi.NAME=VALUE",
        "physical parameters NAMES, learned with the policy; psi.NAME is an initial value",
        [*declared(PsiLearning), *declared(RandomSearch)],
    )
    every = SettingGroup("train", "-s NAME=VALUE", "settings of all algorithms of ocp train", declared(Experiment))
    return [every, psi, *_groups(ALGORITHMS, "-s {}.NAME=VALUE")]


def solver(name: str) -> SettingGroup:
    """The options of a solver, from its documentation, with our defaults."""
    given: dict[str, Any] = IPOPT_DEFAULTS if name == "ipopt" else {}
    found = [
        Setting(key, option.expected, given.get(key, option.default), option.meaning)
        for key, option in documented(name).items()
    ]
    return SettingGroup(name, "-s NAME=VALUE", SOLVERS[name], found)


def groups() -> list[SettingGroup]:
    """All settings except the solvers' options."""
    return [group for kind in kinds().values() for group in kind]


def kinds() -> dict[str, list[SettingGroup]]:
    """The groups by what they belong to; a word of ``ocp settings``."""
    return {"methods": methods(), "laws": laws(), "estimators": estimators(), "training": training()}


def changed(group: SettingGroup) -> SettingGroup:
    """The options of a solver whose default here differs from the solver's own."""
    own = documented(group.name)
    kept = [one for one in group.settings if default_text(one.default) != own[one.name].default]
    return replace(group, settings=kept)


def matching(word: str) -> list[SettingGroup]:
    """The groups of a kind, the one group called ``word``, or all settings of that name.

    A file (``*.py``) is that of a user's law.

    Raises :class:`~ocp.errors.InputError` with the nearest name where there is none.
    """
    named = {group.name: group for group in groups()}
    if word.endswith(".py"):
        return [law(word)]
    if word in kinds():
        return kinds()[word]
    if word in SOLVERS:
        return [solver(word)]
    if word in named:
        return [named[word]]
    every = [*named.values(), *map(solver, SOLVERS)]
    last = word.rpartition(".")[2]
    found = [replace(group, settings=[one for one in group.settings if one.name == last]) for group in every]
    if not any(group.settings for group in found):
        choices = [*kinds(), *named, *SOLVERS]
        choices += [one.name for group in every for one in group.settings]
        raise InputError(
            f"unknown name {word!r}{did_you_mean(word, choices)}; groups:"
            f" {', '.join(dict.fromkeys([*kinds(), *named, *SOLVERS]))}"
        )
    return [group for group in found if group.settings]


def line(one: Setting) -> str:
    """A setting as it is typed, its type and its meaning, on lines of 80 columns."""
    default = default_text(one.default)
    text = f"{one.name}={default}" if default else one.name
    kind = f" ({one.kind})" if one.kind else ""
    return fill(
        f"{text}{kind}: {one.meaning}".rstrip(": "),
        80,
        initial_indent="  ",
        subsequent_indent="      ",
        break_on_hyphens=False,
    )


def default_text(value: Any) -> str:
    """A default as it is typed on the command line; nothing for none."""
    if value is None or isinstance(value, bool):
        return "" if value is None else str(value).lower()
    if isinstance(value, tuple):
        return ",".join(map(str, value)) or "affine"
    return f"{value:g}" if isinstance(value, float) else str(value)
