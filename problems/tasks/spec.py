"""A named task as the workbench knows it: parameters, builder, drawing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ocp.task import Task
from problems.drawing import ContactFrame, Shape
from problems.spec import Spec


@dataclass(frozen=True, kw_only=True)
class TaskSpec(Spec):
    """One named task, at any parameters.

    ``build(params)`` gives the :class:`~ocp.task.Task`; ``draw(params, state)`` the shapes at one
    state (nx,), ``frames(params, state)`` the place and direction of each contact; ``axes`` label
    the drawing. ``decisions`` is how many inputs of an episode matter, None for one a step: of a
    throw the first. ``known`` bounds observations by name, those that do not reach any number.
    ``training`` are settings by which an algorithm learns this task, of the
    algorithm called so, and under ``"all"`` of every one; others are at their own defaults.
    ``learner`` is the algorithm that learns it where none is named.
    """

    build: Callable[[Any], Task]
    draw: Callable[[Any, np.ndarray], list[Shape]]
    frames: Callable[[Any, np.ndarray], list[ContactFrame]]
    axes: tuple[str, str]
    decisions: int | None = None
    known: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    training: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    learner: str = "fopg"

    def task(self, values: Mapping[str, Any] | None = None) -> Task:
        """Build the task at ``values``, the rest at their defaults.

        Raises :class:`~ocp.errors.InputError` for a bad parameter.
        """
        return self.build(self.params(values or {}))
