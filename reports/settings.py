"""Every setting there is, from where it is declared: laws, solves, policies, solvers, training."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from textwrap import fill
from typing import Any

from ocp.settings import Setting, declared


@dataclass(frozen=True)
class Group:
    """Settings of one thing: its name, how one of them is said, and what it is."""

    name: str
    said: str
    summary: str
    settings: list[Setting]

    def row(self) -> dict[str, Any]:
        """As JSON has it."""
        told = [vars(setting) for setting in self.settings]
        return {**vars(self), "settings": told}


def laws() -> list[Group]:
    """Contact laws with the settings that ``-c`` takes."""
    from dynamics.laws import LAWS

    return [Group(name, "-c NAME=VALUE", law.summary, declared(law)) for name, law in LAWS.items()]


def solves() -> Group:
    """Our own settings of a solve."""
    from ocp.settings import Settings

    return Group("solve", "-s NAME=VALUE", "how an answer is reached", declared(Settings))


def policies() -> list[Group]:
    """Policies with their settings."""
    from ocp.policy import POLICIES

    return [
        Group(name, "-s policy.NAME=VALUE", policy.summary, declared(policy))
        for name, policy in POLICIES.items()
    ]


def estimators() -> list[Group]:
    """Estimators that mix two orders, with the settings of ``ocp estimate``."""
    from ocp.gradients.interpolation import RULES

    return [
        Group(name, f"-s {name}.NAME=VALUE", rule.summary, declared(rule))
        for name, rule in RULES.items()
    ]


def training() -> list[Group]:
    """What ``ocp train`` takes: of all algorithms, and of each."""
    from ocp.learning.algorithms import ALGORITHMS
    from ocp.learning.experiment import Experiment
    from ocp.learning.identification import RandomSearch
    from ocp.learning.identification.psi_learning import PsiLearning

    psi = Group(
        "psi", "-s psi=NAMES, and -s psi.NAME=VALUE",
        "physical parameters NAMES learned beside the policy, from psi.NAME on",
        [*declared(PsiLearning), *declared(RandomSearch)],
    )  # fmt: skip
    every = Group("train", "-s NAME=VALUE", "of every algorithm of ocp train", declared(Experiment))
    return [every, psi] + [
        Group(name, f"-s {name}.NAME=VALUE", algorithm.summary, declared(algorithm))
        for name, algorithm in ALGORITHMS.items()
    ]


def solver(name: str) -> Group:
    """The options of a solver, as it documents them, with the values that it is given here."""
    from ocp.programs.options import documented
    from ocp.programs.solver import IPOPT_DEFAULTS, SOLVERS

    given: dict[str, Any] = IPOPT_DEFAULTS if name == "ipopt" else {}
    found = [
        Setting(key, option.expected, given.get(key, option.default), option.meaning)
        for key, option in documented(name).items()
    ]
    return Group(name, "-s NAME=VALUE", SOLVERS[name], found)


def groups() -> list[Group]:
    """Everything but the solvers' options, in the order in which a person meets it."""
    return [solves(), *policies(), *laws(), *estimators(), *training()]


def changed(group: Group) -> Group:
    """Of a solver's options those that this program sets otherwise than the solver would."""
    from ocp.programs.options import documented

    own = documented(group.name)
    kept = [one for one in group.settings if shown(one.default) != own[one.name].default]
    return replace(group, settings=kept)


def matching(word: str) -> list[Group]:
    """What is called ``word``: one thing with its settings, or the settings of that name.

    Raises :class:`~ocp.errors.InputError` with the nearest name where there is none.
    """
    from ocp.errors import InputError, did_you_mean
    from ocp.programs.solver import SOLVERS

    named = {group.name: group for group in groups()}
    if word in SOLVERS:
        return [solver(word)]
    if word in named:
        return [named[word]]
    every = [*named.values(), *map(solver, SOLVERS)]
    last = word.rpartition(".")[2]
    found = [
        replace(group, settings=[one for one in group.settings if one.name == last])
        for group in every
    ]
    if not any(group.settings for group in found):
        known = [*named, *SOLVERS, *(one.name for group in every for one in group.settings)]
        raise InputError(
            f"nothing is called {word!r}{did_you_mean(word, known)}; there are settings of"
            f" {', '.join([*named, *SOLVERS])}"
        )
    return [group for group in found if group.settings]


def line(one: Setting) -> str:
    """A setting as it would be said, with the kind of its value and its meaning; 80 columns."""
    default = shown(one.default)
    said = f"{one.name}={default}" if default else one.name
    return fill(f"{said} ({one.kind}): {one.meaning}".rstrip(": "), 80, initial_indent="  ",
                subsequent_indent="      ", break_on_hyphens=False)  # fmt: skip


def shown(value: Any) -> str:
    """A default as it would be said; nothing for none."""
    if value is None or isinstance(value, bool):
        return "" if value is None else str(value).lower()
    if isinstance(value, tuple):
        return ",".join(map(str, value)) or "affine"
    return f"{value:g}" if isinstance(value, float) else str(value)


def methods() -> Iterator[Mapping[str, Any]]:
    """Methods with what they are; their settings are those of a solve and of its policy."""
    from ocp.transcription import METHODS

    for name, method in METHODS.items():
        yield {"name": name, "summary": method.summary}
