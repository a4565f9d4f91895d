"""From the words of ``ocp train`` to algorithms with their settings, and to what help shows."""

from __future__ import annotations

from dataclasses import MISSING, Field, fields
from typing import TYPE_CHECKING, Any, get_type_hints

from ocp.errors import InputError, choose, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ocp.learning.protocol import Algorithm

OWN = {
    "hidden": "units of each tanh layer of the policy, such as 64,64; affine without, or open-loop",
    "initial": "size of the last layer's first weights",
    "normalise": "true or false: by the running mean and scale of what was seen",
    "discount": "of later rewards, above 0 and at most 1",
    "evaluate_every": "iterations from one judgement under the exact law to the next",
    "episodes": "of each judgement",
}
"""Settings that every algorithm has, fields of :class:`~ocp.learning.experiment.Experiment`."""
_SHAPES: dict[str, tuple[int, ...] | None] = {"affine": (), "open-loop": None}


def algorithms(names: str, given: Mapping[str, str]) -> tuple[list[Algorithm], dict[str, Any]]:
    """Make the algorithms ``names`` (with commas) from settings; gives them, and what is shared.

    ``name=value`` goes to all that have it, ``ars.name=value`` to one.

    Raises :class:`~ocp.errors.InputError` for an unknown algorithm, and for a setting that none of
    them has, or that cannot be.
    """
    from ocp.learning.algorithms import ALGORITHMS
    from ocp.settings import read

    words = [name.strip() for name in names.split(",") if name.strip()]
    if not words:
        raise InputError(f"--algorithm: expected names with commas, got {names!r}")
    chosen = {word: choose("algorithm", word, ALGORITHMS) for word in words}
    if len(chosen) < len(words):
        raise InputError(f"--algorithm: {names} names one twice; name each once")
    shared = {name: _option(name, value) for name, value in given.items() if name in OWN}
    own: dict[str, dict[str, Any]] = {word: {} for word in chosen}
    for key, value in given.items():
        if key in OWN:
            continue
        owner, dot, name = key.rpartition(".")
        takers = [w for w in chosen if (not dot or w == owner) and name in _settings(chosen[w])]
        if not takers:
            raise InputError(_unknown(key, chosen))
        for word in takers:
            kind = get_type_hints(chosen[word])[name]
            own[word][name] = read(f"setting {key}", value, kind)
    return [_made(chosen[word], own[word]) for word in chosen], shared


def _unknown(key: str, chosen: Mapping[str, type]) -> str:
    known = {**OWN, **{name: "" for cls in chosen.values() for name in _settings(cls)}}
    return (
        f"no setting {key!r} of {', '.join(chosen)}{did_you_mean(key, known)}; there are"
        f" {', '.join(known)}"
    )


def _settings(cls: type) -> dict[str, Field[Any]]:
    return {field.name: field for field in fields(cls) if field.init}


def _option(name: str, value: str) -> Any:
    from ocp.learning.experiment import Experiment
    from ocp.settings import read

    if name == "hidden":
        return _hidden(value)
    return read(f"setting {name}", value, type(Experiment.__dataclass_fields__[name].default))


def _hidden(text: str) -> tuple[int, ...] | None:
    if text in _SHAPES:
        return _SHAPES[text]
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isascii() and part.isdigit() and 0 < int(part) <= 100_000 for part in parts):
        raise InputError(
            "setting hidden must be whole numbers from 1 to 100000 with commas, such as 64,64,"
            f" {' or '.join(_SHAPES)}, got {text!r}"
        )
    return tuple(map(int, parts))


def _made(cls: type, values: Mapping[str, Any]) -> Any:
    try:
        return cls(**values)
    except (TypeError, ValueError) as error:
        raise InputError(str(error)) from error


def help_text() -> str:
    """Tasks, algorithms and settings with their defaults, a line each."""
    from ocp.learning.algorithms import ALGORITHMS
    from ocp.learning.experiment import Experiment
    from problems.tasks import registry

    tasks = [(name, registry.spec(name).title) for name in registry.names()]
    shared = {field.name: field for field in fields(Experiment)}
    parts = ["Tasks:", *_table(tasks), "", "Settings of all algorithms, -s name=value:"]
    parts += _table([(_shown(shared[name]), meaning) for name, meaning in OWN.items()])
    for name, cls in ALGORITHMS.items():
        own = ", ".join(_shown(field) for field in _settings(cls).values())
        parts += ["", f"{name}: {cls.summary}", f"  {own}"]
    return "\n".join(parts)


def _table(rows: Sequence[tuple[str, str]]) -> list[str]:
    wide = max(len(name) for name, _ in rows)
    return [f"  {name:<{wide}}  {meaning}" for name, meaning in rows]


def _shown(field: Field[Any]) -> str:
    if field.default is MISSING:
        return field.name
    return f"{field.name}={_word(field.default)}"


def _word(value: Any) -> str:
    if value is None or isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        return ",".join(map(str, value)) or "affine"
    return f"{value:g}" if isinstance(value, float) else str(value)
