"""Settings by which an algorithm usually learns a task, and the algorithm made of settings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import Field, fields
from typing import Any

from ocp.errors import InputError
from ocp.learning.experiment import Experiment
from ocp.learning.protocol import Algorithm
from problems.tasks.spec import TaskSpec


def usual(spec: TaskSpec, word: str, cls: type) -> dict[str, Any]:
    """What the task has of the settings of the algorithm ``word``, and of its experiment's."""
    known = {**spec.training.get("all", {}), **spec.training.get(word, {})}
    own = {**settings_of(cls), **settings_of(Experiment)}
    return {name: value for name, value in known.items() if name in own}


def made(cls: type, values: Mapping[str, Any]) -> tuple[Algorithm, dict[str, Any]]:
    """The algorithm of its own settings among ``values``, and the others, its experiment's.

    Raises :class:`~ocp.errors.InputError` where they cannot be.
    """
    own = {name: value for name, value in values.items() if name in settings_of(cls)}
    try:
        algorithm = cls(**own)
    except (TypeError, ValueError) as error:
        raise InputError(str(error)) from error
    return algorithm, {name: value for name, value in values.items() if name not in own}


def settings_of(cls: type) -> dict[str, Field[Any]]:
    """Fields that may be given, by name."""
    return {field.name: field for field in fields(cls) if field.init}
