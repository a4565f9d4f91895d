"""Every task by name."""

from __future__ import annotations

import importlib
from functools import cache
from typing import Any

from ocp.errors import choose
from ocp.task import Task
from problems.spec import defined
from problems.tasks.spec import TaskSpec

_MODULES = {
    "ball-throw": "problems.tasks.ball_throw",
    "hopper": "problems.tasks.hopper",
    "half-cheetah": "problems.tasks.half_cheetah",
}


def names() -> list[str]:
    """Names of the tasks that ship with the workbench."""
    return list(_MODULES)


def spec(name: str) -> TaskSpec:
    """Return the task called ``name``; raises :class:`~ocp.errors.InputError` for no name."""
    return _registered(choose("task", name, _MODULES))


def get(name: str, **params: Any) -> Task:
    """Build the task ``name`` with ``params``, the rest at their defaults.

    Raises :class:`~ocp.errors.InputError` for an unknown name or a bad parameter.
    """
    return spec(name).task(params)


@cache
def _registered(module: str) -> TaskSpec:
    return defined(TaskSpec, importlib.import_module(module))
