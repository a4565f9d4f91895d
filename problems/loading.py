"""A user's problem file: imported, and checked before any command uses it."""

from __future__ import annotations

import importlib.util
import sys
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType
from typing import cast

import numpy as np

from ocp.errors import InputError
from ocp.problem import Problem
from ocp.store.provenance import file_digest
from problems.source_digest import folder_modules, open_to_imports
from problems.spec import ProblemSpec, reason, where


def import_file(path: Path) -> ModuleType:
    """Import the module at ``path`` (absolute), each time afresh.

    It may import modules that lie beside it, as a program may; one that has changed, or that came
    from another file's folder, is imported afresh too.

    Raises :class:`~ocp.errors.InputError` where there is no such file, or it raises.
    """
    check_file(path)
    name = f"user_problem_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path, loader=_Afresh(name, str(path)))
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: not a Python file; expected one that defines a problem")
    module = importlib.util.module_from_spec(spec)
    # pydantic looks a model's annotations up in the module of that name.
    sys.modules[spec.name] = module
    open_to_imports(path.parent)
    _forget_others(path)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise InputError(f"{path}: the file raised at {where(error, path)}") from error
    return module


def check_file(path: Path) -> None:
    """Raise :class:`~ocp.errors.InputError` where there is no such file."""
    if not path.is_file():
        kind = "is a directory" if path.is_dir() else "there is no such file"
        raise InputError(f"{path}: {kind}; expected a Python file that defines a problem")


class _Afresh(SourceFileLoader):
    """Compiles the file as it is: bytecode kept beside it goes by whole seconds and the size."""

    def get_code(self, fullname: str) -> CodeType:
        content = self.get_data(self.path)
        return cast("CodeType", self.source_to_code(content, self.path))


_contents: dict[str, tuple[str, str]] = {}
"""File and digest of every module beside a user's file, as it was imported."""


def _forget_others(path: Path) -> None:
    """Drop modules that are not what the file would import now, and those that may have used them.

    Raises :class:`~ocp.errors.InputError` where one cannot be read.
    """
    modules = folder_modules(path)
    now = {name: (str(file), file_digest(file)) for name, file in modules.items()}
    loaded = {name: str(sys.modules[name].__file__) for name in now if name in sys.modules}
    if any(_contents.get(name, (file, now[name][1])) != now[name] for name, file in loaded.items()):
        for name in loaded:
            del sys.modules[name]
    _contents.update(now)


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
        "the guess": lambda: _check_guess(problem, p),
    }
    for what, evaluate in parts.items():
        try:
            evaluate()
        except Exception as error:
            raise InputError(f"{spec.path}: {what} does not fit: {reason(error)}") from error
    start = problem.initial_states(p)
    if not np.all(np.isfinite(start)):
        raise InputError(f"{spec.path}: x0 is not finite: {start[0]}")
    cost = np.array(problem.cost_terms(start[0], np.zeros(system.nu), np.zeros(system.nu), p))
    if not np.all(np.isfinite(cost)):
        raise InputError(f"{spec.path}: the cost is not a finite number at x0 and u = 0")
    if spec.draw is not None:
        try:
            spec.draw(spec.params({}), start[0])
        except Exception as error:
            path = spec.path or Path()
            raise InputError(f"{path}: draw(params, state) failed: {where(error, path)}") from error


def _check_limits(problem: Problem) -> None:
    limits, nx, nu = problem.limits, problem.system.nx, problem.system.nu
    for index in range(limits.n_out()):
        name, rows = limits.name_out(index), limits.size1_out(index)
        expected = nx if name.startswith("x") else nu
        if rows != expected:
            raise ValueError(f"{name} has {rows} entries, expected {expected}")


def _check_guess(problem: Problem, p: np.ndarray) -> None:
    states, inputs = problem.initial_guess(p)
    expected = (problem.N + 1, problem.system.nx), (problem.N, problem.system.nu)
    shapes = np.shape(states), np.shape(inputs)
    if shapes != expected:
        raise ValueError(f"it has states {shapes[0]} and inputs {shapes[1]}, expected {expected}")
