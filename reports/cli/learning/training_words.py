"""From the words of ``ocp train`` to algorithms with their settings, and to what help shows."""

from __future__ import annotations

from dataclasses import fields
from textwrap import fill
from typing import TYPE_CHECKING, Any, get_type_hints

from ocp.errors import InputError, choose, did_you_mean
from ocp.learning.experiment import Experiment
from ocp.settings import declared
from ocp.words.numbers import whole
from problems.tasks.usual import made, settings_of, usual
from reports.cli.learning.psi_words import SETTINGS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ocp.learning.protocol import Algorithm
    from problems.tasks.spec import TaskSpec

OWN = {setting.name: setting.meaning for setting in declared(Experiment)}
"""Settings that every algorithm has, fields of :class:`~ocp.learning.experiment.Experiment`."""
_SHAPES: dict[str, tuple[int, ...] | None] = {"affine": (), "open-loop": None}


Asked = list[tuple["Algorithm", dict[str, Any]]]
"""Algorithms, and of each what its experiment is to be, by the names of its fields."""


def algorithms(names: str, given: Mapping[str, str], spec: TaskSpec) -> Asked:
    """Make the algorithms ``names`` (with commas) from settings, for the task of ``spec``.

    ``name=value`` goes to all that have it, ``ars.name=value`` to one; what is not given is as the
    task has it, else as the algorithm has it.

    Raises :class:`~ocp.errors.InputError` for an unknown algorithm, and for a setting that none of
    them has, or that cannot be.
    """
    from ocp.learning.algorithms import ALGORITHMS

    words = [name.strip() for name in names.split(",") if name.strip()]
    if not words:
        raise InputError(f"--algorithm: expected names with commas, got {names!r}")
    chosen = {word: choose("algorithm", word, ALGORITHMS) for word in words}
    if len(chosen) < len(words):
        raise InputError(f"--algorithm: {names} names one twice; name each once")
    values = {word: usual(spec, word, cls) for word, cls in chosen.items()}
    for key, text in given.items():
        owner, dot, name = key.rpartition(".")
        alone = [word for word in chosen if not dot or word == owner]
        takers = [word for word in alone if name in OWN or name in settings_of(chosen[word])]
        if not takers:
            raise InputError(_unknown(key, chosen))
        for word in takers:
            values[word][name] = _value(key, name, text, chosen[word])
    return [made(chosen[word], values[word]) for word in chosen]


def _unknown(key: str, chosen: Mapping[str, type]) -> str:
    known = {**OWN, **{name: "" for cls in chosen.values() for name in settings_of(cls)}}
    return (
        f"no setting {key!r} of {', '.join(chosen)}{did_you_mean(key, known)}; there are"
        f" {', '.join(known)}"
    )


def _value(key: str, name: str, text: str, cls: type) -> Any:
    from ocp.words.typed import read

    if name == "hidden":
        return _hidden(text)
    if name not in OWN:
        return read(f"setting {key}", text, get_type_hints(cls)[name])
    return read(f"setting {key}", text, type(settings_of(Experiment)[name].default))


def _hidden(text: str) -> tuple[int, ...] | None:
    if text in _SHAPES:
        return _SHAPES[text]
    units = [whole(part) for part in text.split(",")]
    if not all(count is not None and 0 < count <= 100_000 for count in units):
        raise InputError(
            "setting hidden must be whole numbers from 1 to 100000 with commas, such as 64,64,"
            f" {' or '.join(_SHAPES)}, got {text!r}"
        )
    return tuple(count for count in units if count is not None)


def help_text() -> str:
    """Tasks, algorithms and settings with their defaults, a line each."""
    from ocp.learning.algorithms import ALGORITHMS
    from problems.tasks import registry

    specs = [registry.spec(name) for name in registry.names()]
    tasks = [(spec.name, f"{spec.title}; {spec.learner}") for spec in specs]
    shared = {field.name: field for field in fields(Experiment)}
    parts = ["Tasks, and the algorithm that is usual:", *_table(tasks)]
    parts += ["", "Settings of all algorithms, -s name=value:"]
    parts += _table([(_shown(name, shared[name].default), OWN[name]) for name in OWN])
    parts += ["", "Physical parameters learned beside the policy:", *_table([*SETTINGS.items()])]
    for name, cls in ALGORITHMS.items():
        own = {field.name: field.default for field in settings_of(cls).values()}
        parts += ["", f"{name}: {cls.summary}; {cls.contact} law", _listed(own)]
    for spec in specs:
        for whose, values in spec.training.items():
            parts += ["", f"{spec.name} has of {whose}, unless told otherwise:", _listed(values)]
    return "\n".join(parts)


def _table(rows: Sequence[tuple[str, str]]) -> list[str]:
    wide = max(len(name) for name, _ in rows)
    return [f"  {name:<{wide}}  {meaning}" for name, meaning in rows]


def _listed(values: Mapping[str, Any]) -> str:
    told = ", ".join(_shown(name, value) for name, value in values.items())
    return fill(told, 78, initial_indent="  ", subsequent_indent="  ")


def _shown(name: str, value: Any) -> str:
    return f"{name}={'open-loop' if (name, value) == ('hidden', None) else _word(value)}"


def _word(value: Any) -> str:
    if value is None or isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return ",".join(map(str, value)) or "affine"
    return f"{value:g}" if isinstance(value, float) else str(value)
