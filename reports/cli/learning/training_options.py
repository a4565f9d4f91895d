"""Settings of ``ocp train``: algorithms, learned physical parameters, and the help text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from textwrap import fill
from typing import Any

from dynamics.settings import read_value, settings_of
from ocp.errors import InputError, choose, did_you_mean
from ocp.learning.experiment import Experiment
from ocp.learning.protocol import Algorithm
from ocp.learning.psi_learning import PsiLearning
from ocp.learning.training import ALGORITHMS
from ocp.search.random_search import RandomSearch
from problems.tasks import registry
from problems.tasks.registry import TaskSpec, default_settings, make_algorithm
from reports.tables.settings import default_text, setting_rows

SHARED_SETTINGS = {name: setting for name, setting in settings_of(Experiment).items() if setting.meaning}
"""Settings of every algorithm; they are fields of :class:`~ocp.learning.experiment.Experiment`."""
_POLICY_SHAPES: dict[str, tuple[int, ...] | None] = {"affine": (), "open-loop": None}
"""Mapping from named policies to the sizes of hidden layers; None for an open-loop policy."""


Chosen = list[tuple[Algorithm, dict[str, Any]]]
"""Algorithms, each with a mapping from fields of its experiment to values."""


def algorithms(names: str, setting_texts: Mapping[str, str], spec: TaskSpec) -> Chosen:
    """Return the algorithms in ``names``, separated by commas, with their settings for the task of ``spec``.

    The setting ``name=value`` applies to all algorithms that have it, ``ars.name=value`` only to ``ars``.
    Defaults are taken from the task or, if it has none, from the algorithm.

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
        owners = [word for word in candidates if name in SHARED_SETTINGS or name in settings_of(chosen[word])]
        if not owners:
            raise InputError(_unknown(key, chosen))
        for word in owners:
            values[word][name] = _value(key, name, text, chosen[word])
    return [make_algorithm(chosen[word], values[word]) for word in chosen]


def _unknown(key: str, chosen: Mapping[str, type]) -> str:
    choices = [*dict.fromkeys([*SHARED_SETTINGS, *(name for cls in chosen.values() for name in settings_of(cls))])]
    return f"no setting {key!r} of {', '.join(chosen)}{did_you_mean(key, choices)}; available: {', '.join(choices)}"


def _value(key: str, name: str, text: str, cls: type) -> Any:
    if name == "hidden" and text in _POLICY_SHAPES:
        return _POLICY_SHAPES[text]
    setting = SHARED_SETTINGS.get(name) or settings_of(cls)[name]
    return setting.read(text, f"setting {key.removesuffix(name)}")


def help_text() -> str:
    """Return tasks, algorithms and settings with their defaults, one per line."""
    specs = [registry.spec(name) for name in registry.names()]
    tasks = [(spec.name, f"{spec.title}; {spec.learner}") for spec in specs]
    paragraphs = ["Tasks, and their default algorithm:", *_table(tasks)]
    paragraphs += ["", "Settings of all algorithms, -s name=value:"]
    paragraphs += _table([(_setting(name, about.default), about.meaning) for name, about in SHARED_SETTINGS.items()])
    psi = {f"{PSI}.{row.name}": row.default for cls in (PsiLearning, RandomSearch) for row in setting_rows(cls)}
    paragraphs += ["", "Physical parameters learned with the policy: -s psi=NAME,NAME; psi.NAME=value: initial value"]
    paragraphs += [_listed(psi)]
    for name, cls in ALGORITHMS.items():
        defaults = {key: setting.default for key, setting in settings_of(cls).items()}
        paragraphs += ["", f"{name}: {cls.summary}; {cls.contact} law", _listed(defaults)]
    for spec in specs:
        for algorithm_name, values in spec.training.items():
            paragraphs += ["", f"Defaults of {spec.name} for {algorithm_name}:", _listed(values)]
    return "\n".join(paragraphs)


def _table(rows: Sequence[tuple[str, str]]) -> list[str]:
    name_width = max(len(name) for name, _ in rows)
    return [f"  {name:<{name_width}}  {meaning}" for name, meaning in rows]


def _listed(values: Mapping[str, Any]) -> str:
    text = ", ".join(_setting(name, value) for name, value in values.items())
    return fill(text, 78, initial_indent="  ", subsequent_indent="  ")


def _setting(name: str, value: Any) -> str:
    return f"{name}={'open-loop' if (name, value) == ('hidden', None) else default_text(value)}"


PSI = "psi"
"""Name of the setting with the physical parameters to learn, and prefix of its settings."""


@dataclass(frozen=True)
class LearnedParameters:
    """Names of physical parameters to learn, with settings; ``guesses`` maps names to initial values."""

    names: tuple[str, ...] = ()
    guesses: dict[str, float] = field(default_factory=dict)
    psi_settings: dict[str, Any] = field(default_factory=dict)
    search_settings: dict[str, Any] = field(default_factory=dict)

    def wrap(self, algorithm: Algorithm) -> Algorithm:
        """Return the algorithm or, if there are parameters to learn, a wrapper that also learns these."""
        if not self.names:
            return algorithm
        search = RandomSearch(**self.search_settings)
        return PsiLearning(algorithm=algorithm, names=self.names, search=search, **self.psi_settings)


def learned_parameters(setting_texts: Mapping[str, str], physical: Sequence[str]) -> LearnedParameters:
    """Return the parameters to learn, from the settings of psi; ``physical`` are names of the task's parameters.

    Raises :class:`~ocp.errors.InputError` for unknown names and bad values.
    """
    learning, search = settings_of(PsiLearning), settings_of(RandomSearch)
    choices = [*physical, *learning, *search]
    learned = LearnedParameters(_physical_names(setting_texts.get(PSI, ""), physical))
    for key, text in setting_texts.items():
        name = key.removeprefix(f"{PSI}.")
        if not is_psi(key) or key == PSI:
            continue
        if name not in choices:
            raise InputError(f"no setting {key!r}{did_you_mean(name, choices)}; psi takes {', '.join(choices)}")
        if name in learning:
            learned.psi_settings[name] = learning[name].read(text, f"setting {PSI}.")
        elif name in search:
            learned.search_settings[name] = search[name].read(text, f"setting {PSI}.")
        else:
            learned.guesses[name] = read_value(f"setting {key}", text, float)
    without_names = {**learned.psi_settings, **learned.search_settings}
    if not learned.names and without_names:
        raise InputError(
            f"setting {PSI}.{next(iter(without_names))} needs a learned physical parameter; add -s {PSI}={physical[0]}"
        )
    return learned


def is_psi(key: str) -> bool:
    """Return whether the name of a setting is ``psi`` or begins with ``psi.``."""
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
