"""A user's problem file: imported, and checked before any command uses it."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
from pydantic import BaseModel, JsonValue

from ocp.errors import InputError
from ocp.given import Line, checked
from ocp.problem import Problem
from problems.own_code import reason, told
from problems.spec import ProblemSpec, describe


def import_file(path: Path) -> ModuleType:
    """Import the module at ``path`` (absolute), each time afresh.

    Raises :class:`~ocp.errors.InputError` where there is no such file, or it raises.
    """
    if not path.is_file():
        kind = (
            "is a directory" if path.is_dir() else "is no regular file" if path.exists()
            else "there is no such file"
        )  # fmt: skip
        raise InputError(f"{path}: {kind}; expected a Python file that defines a problem")
    spec = importlib.util.spec_from_file_location(f"user_problem_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: not a Python file; expected one that defines a problem")
    module = importlib.util.module_from_spec(spec)
    # pydantic looks a model's annotations up in the module of that name.
    sys.modules[spec.name] = module
    with told("the file raised at", path):
        spec.loader.exec_module(module)
    return module


def check(spec: ProblemSpec) -> None:
    """Build the problem at its defaults and evaluate every part of it once.

    Raises :class:`~ocp.errors.InputError` naming the part whose dimension or value does not fit.
    """
    problem = spec.problem()
    p = problem.parameters.values
    system = problem.system
    parts = {
        "the system": lambda: system.reduced,
        "x0, u_before or a bound": lambda: _check_limits(problem),
        "the cost": lambda: problem.cost_terms,
    }
    for what, evaluate in parts.items():
        try:
            evaluate()
        except Exception as error:
            raise InputError(f"{spec.path}: {what} does not fit: {reason(error)}") from error
    problem.initial_guess(p)
    start = problem.initial_states(p)
    if not np.all(np.isfinite(start)):
        raise InputError(f"{spec.path}: x0 is not finite: {start[0]}")
    cost = np.array(problem.cost_terms(start[0], np.zeros(system.nu), np.zeros(system.nu), p))
    if not np.all(np.isfinite(cost)):
        raise InputError(f"{spec.path}: the cost is not a finite number at x0 and u = 0")
    params = spec.params({})
    for look in (spec.draw, spec.frames):
        if look is not None:
            look(params, start[0])
    _check_words(spec, params)


def _check_words(spec: ProblemSpec, params: BaseModel) -> None:
    """Values that a run's record can hold, and words that a terminal can show."""
    for about in describe(spec):
        parameter = f"parameter {checked(f'{spec.path}: a parameter', about['name'], Line)}"
        for what in ("unit", "description"):
            checked(f"{spec.path}: the {what} of {parameter}", about[what], Line)
    for name, value in params.model_dump().items():
        checked(f"{spec.path}: parameter {name}", value, JsonValue)


def _check_limits(problem: Problem) -> None:
    limits, nx, nu = problem.limits, problem.system.nx, problem.system.nu
    for index in range(limits.n_out()):
        name, rows = limits.name_out(index), limits.size1_out(index)
        expected = nx if name.startswith("x") else nu
        if rows != expected:
            raise ValueError(f"{name} has {rows} entries, expected {expected}")
