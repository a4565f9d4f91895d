"""Look-up of tasks by name, and the settings of the algorithms for each task."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.settings import settings_of
from ocp.errors import InputError, choose
from ocp.problem.task import Task
from problems.drawing import ContactFrame, Shape
from problems.spec import Spec, spec_from_module

if TYPE_CHECKING:
    from ocp.learning.protocol import Algorithm


@dataclass(frozen=True, kw_only=True)
class TaskSpec(Spec):
    """Specification of a named task, which can be built at any parameter values.

    ``build(params)`` returns the :class:`~ocp.problem.task.Task`, ``draw(params, state)`` the shapes at
    one state (nx,), ``frames(params, state)`` the point and direction of each contact; ``axes`` are
    labels of the drawing. ``decisions`` is the number of steps whose input has an effect (1 for a
    throw), None for all steps. ``observation_bounds`` maps names of observations to their finite
    ranges. ``training`` maps an algorithm's name to its settings for this task, and ``"all"`` to settings
    of every algorithm; other settings keep their defaults. ``learner`` is the default algorithm.
    """

    build: Callable[[Any], Task]
    draw: Callable[[Any, np.ndarray], list[Shape]]
    frames: Callable[[Any, np.ndarray], list[ContactFrame]]
    axes: tuple[str, str]
    decisions: int | None = None
    observation_bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    training: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    learner: str = "fopg"

    def task(self, values: Mapping[str, Any] | None = None) -> Task:
        """Build the task at ``values`` and the defaults of the other parameters.

        Raises :class:`~ocp.errors.InputError` for a bad parameter.
        """
        return self.build(self.params(values or {}))


TASK_MODULES = {
    "ball-throw": "problems.tasks.ball_throw",
    "hopper": "problems.bodies.hopper.task",
    "half-cheetah": "problems.bodies.half_cheetah.task",
}
"""Mapping from the name of a task to its module."""


def names() -> list[str]:
    """Return the names of the tasks that ship with the workbench."""
    return list(TASK_MODULES)


@cache
def spec(name: str) -> TaskSpec:
    """Return the task called ``name``; raises :class:`~ocp.errors.InputError` if it is unknown."""
    return spec_from_module(TaskSpec, importlib.import_module(choose("task", name, TASK_MODULES)))


def get(name: str, **params: Any) -> Task:
    """Build the task ``name`` with ``params`` and the defaults of the other parameters.

    Raises :class:`~ocp.errors.InputError` for an unknown name or a bad parameter.
    """
    return spec(name).task(params)


def default_settings(spec: TaskSpec, word: str, cls: type) -> dict[str, Any]:
    """Return the task's default settings for the algorithm ``cls``, called ``word``, and for the experiment."""
    from ocp.learning.experiment import Experiment

    settings = {**spec.training.get("all", {}), **spec.training.get(word, {})}
    field_names = {field.name for field in (*fields(cls), *fields(Experiment)) if field.init}
    return {name: value for name, value in settings.items() if name in field_names}


def make_algorithm(cls: type, values: Mapping[str, Any]) -> tuple[Algorithm, dict[str, Any]]:
    """Return the algorithm ``cls`` with its settings from ``values``, and the other values for its experiment.

    Raises :class:`~ocp.errors.InputError` if the algorithm rejects a setting.
    """
    algorithm_settings = {name: value for name, value in values.items() if name in settings_of(cls)}
    try:
        algorithm = cls(**algorithm_settings)
    except (TypeError, ValueError) as error:
        raise InputError(str(error)) from error
    return algorithm, {name: value for name, value in values.items() if name not in algorithm_settings}
