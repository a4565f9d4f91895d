"""Settings of ``ocp train``: algorithms, learned physical parameters, and the help text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from textwrap import fill
from typing import Any, get_type_hints

from ocp.errors import InputError, choose, did_you_mean
from ocp.learning.experiment import Experiment
from ocp.learning.protocol import Algorithm
from ocp.learning.psi_learning import PsiLearning
from ocp.learning.random_search import RandomSearch
from ocp.learning.training import ALGORITHMS
from ocp.solve.request import declared
from ocp.validation import parse
from problems.tasks import registry
from problems.tasks.registry import TaskSpec, default_settings, make_algorithm, settings_of
from reports.cli.request import parse_layers
from reports.tables.settings import default_text

OWN = {setting.name: setting.meaning for setting in declared(Experiment)}
"""Settings that every algorithm has, fields of :class:`~ocp.learning.experiment.Experiment`."""
_POLICY_SHAPES: dict[str, tuple[int, ...] | None] = {"affine": (), "open-loop": None}
"""Hidden layers of policies that have names of their own."""


Chosen = list[tuple[Algorithm, dict[str, Any]]]
"""Algorithms, each with the fields of its experiment by name."""


def algorithms(names: str, setting_texts: Mapping[str, str], spec: TaskSpec) -> Chosen:
    """Return the algorithms called ``names`` (with commas), with settings for the task of ``spec``.

    ``name=value`` sets all that have it, ``ars.name=value`` one; defaults are those of the task,
    then those of the algorithm.

    Raises :class:`~ocp.errors.InputError` for an unknown algorithm or setting, and for a bad value.
    """
    words = [name.strip() for name in names.split(",") if name.strip()]
    if not words:
        raise InputError(f"--algorithm: expected names with commas, got {names!r}")
    chosen = {word: choose("algorithm", word, ALGORITHMS) for word in words}
    if len(chosen) < len(words):
        raise InputError(f"--algorithm: {names} has a name twice; give each once")
    values = {word: default_settings(spec, word, cls) for word, cls in chosen.items()}
    for key, text in setting_texts.items():
        owner, dot, name = key.rpartition(".")
        candidates = [word for word in chosen if not dot or word == owner]
        owners = [word for word in candidates if name in OWN or name in settings_of(chosen[word])]
        if not owners:
            raise InputError(_unknown(key, chosen))
        for word in owners:
            values[word][name] = _value(key, name, text, chosen[word])
    return [make_algorithm(chosen[word], values[word]) for word in chosen]


def _unknown(key: str, chosen: Mapping[str, type]) -> str:
    choices = {**OWN, **{name: "" for cls in chosen.values() for name in settings_of(cls)}}
    return f"no setting {key!r} of {', '.join(chosen)}{did_you_mean(key, choices)}; available: {', '.join(choices)}"


def _value(key: str, name: str, text: str, cls: type) -> Any:
    if name == "hidden":
        if text in _POLICY_SHAPES:
            return _POLICY_SHAPES[text]
        return parse_layers(f"setting {key}", text, f", {' or '.join(_POLICY_SHAPES)}")
    if name not in OWN:
        return parse(f"setting {key}", text, get_type_hints(cls)[name])
    return parse(f"setting {key}", text, type(settings_of(Experiment)[name].default))


def help_text() -> str:
    """Return tasks, algorithms and settings with their defaults, one per line."""
    specs = [registry.spec(name) for name in registry.names()]
    tasks = [(spec.name, f"{spec.title}; {spec.learner}") for spec in specs]
    shared = {field.name: field for field in fields(Experiment)}
    paragraphs = ["Tasks, and their default algorithm:", *_table(tasks)]
    paragraphs += ["", "Settings of all algorithms, -s name=value:"]
    paragraphs += _table([(_setting(name, shared[name].default), OWN[name]) for name in OWN])
    paragraphs += ["", "Physical parameters learned with the policy:", *_table([*PSI_SETTINGS.items()])]
    for name, cls in ALGORITHMS.items():
        defaults = {field.name: field.default for field in settings_of(cls).values()}
        paragraphs += ["", f"{name}: {cls.summary}; {cls.contact} law", _listed(defaults)]
    for spec in specs:
        for algorithm_name, values in spec.training.items():
            paragraphs += ["", f"Defaults of {spec.name} for {algorithm_name}:", _listed(values)]
    return "\n".join(paragraphs)


def _table(rows: Sequence[tuple[str, str]]) -> list[str]:
    wide = max(len(name) for name, _ in rows)
    return [f"  {name:<{wide}}  {meaning}" for name, meaning in rows]


def _listed(values: Mapping[str, Any]) -> str:
    text = ", ".join(_setting(name, value) for name, value in values.items())
    return fill(text, 78, initial_indent="  ", subsequent_indent="  ")


def _setting(name: str, value: Any) -> str:
    return f"{name}={'open-loop' if (name, value) == ('hidden', None) else default_text(value)}"


PSI = "psi"
"""Name of the setting with the physical parameters to learn, and prefix of its settings."""
PSI_SETTINGS = {
    "psi": "parameters of the task to learn, names with commas",
    "psi.NAME": "initial value of a learned parameter",
    "psi.n_envs": "episodes continued in every iteration; psi.steps of each",
}
"""Settings of ``-s``; further ones are fields of PsiLearning and of its random search."""


@dataclass(frozen=True)
class LearnedParameters:
    """Physical parameters to learn, by ``names``; ``guesses`` are initial values by name."""

    names: tuple[str, ...] = ()
    guesses: dict[str, float] = field(default_factory=dict)
    psi_settings: dict[str, Any] = field(default_factory=dict)
    search_settings: dict[str, Any] = field(default_factory=dict)

    def wrap(self, algorithm: Algorithm) -> Algorithm:
        """Return the algorithm, wrapped to learn the parameters where there are any."""

        if not self.names:
            return algorithm
        search = RandomSearch(**self.search_settings)
        return PsiLearning(algorithm=algorithm, names=self.names, search=search, **self.psi_settings)


def learned_parameters(setting_texts: Mapping[str, str], physical: Sequence[str]) -> LearnedParameters:
    """Read the settings that begin with psi; ``physical`` are the names of the task's parameters.

    Raises :class:`~ocp.errors.InputError` for unknown names and bad values.
    """
    kinds = [get_type_hints(PsiLearning), get_type_hints(RandomSearch)]
    psi_types, search_types = (
        {f.name: kind[f.name] for f in fields(cls) if kind[f.name] in (int, float)}
        for cls, kind in zip((PsiLearning, RandomSearch), kinds, strict=True)
    )
    choices = [*physical, *psi_types, *search_types]
    learned = LearnedParameters(_physical_names(setting_texts.get(PSI, ""), physical))
    for key, text in setting_texts.items():
        name = key.removeprefix(f"{PSI}.")
        if not is_psi(key) or key == PSI:
            continue
        if name not in choices:
            raise InputError(f"no setting {key!r}{did_you_mean(name, choices)}; psi takes {', '.join(choices)}")
        kind, values = (
            (psi_types.get(name), learned.psi_settings)
            if name in psi_types
            else (
                (search_types.get(name), learned.search_settings) if name in search_types else (float, learned.guesses)
            )
        )
        values[name] = parse(f"setting {key}", text, kind)
    if not learned.names and (learned.psi_settings or learned.search_settings):
        raise InputError(
            f"setting {PSI}.{next(iter({**learned.psi_settings, **learned.search_settings}))} needs a learned physical"
            f" parameter; add -s {PSI}={physical[0]}"
        )
    return learned


def is_psi(key: str) -> bool:
    """Return whether a setting begins with psi."""
    return key.partition(".")[0] == PSI


def _physical_names(text: str, physical: Sequence[str]) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    for name in names:
        if name not in physical:
            raise InputError(
                f"setting {PSI}: the task has no parameter {name!r}"
                f"{did_you_mean(name, physical)}; available: {', '.join(physical)}"
            )
    if len(set(names)) < len(names):
        raise InputError(f"setting {PSI}: {text} has a name twice; give each once")
    return names
