"""Receding problem: its start and last input are parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from dynamics.systems import Parameter, ParameterTable
from ocp.errors import InputError, did_you_mean
from ocp.mpc.phase import numbers
from ocp.problem.problem import Problem, Scenarios

TERMINAL_WEIGHT = 100.0
"""Weight of softened terminal constraints, in characteristic costs for a characteristic size."""

Values = Mapping[str, "float | np.ndarray"]
"""Parameters by name; an array (N,) or (N+1,) has one value per step of the horizon."""


@dataclass(frozen=True)
class Receding:
    """A problem whose measured state and last input are parameters.

    ``problem`` has the parameters ``measured_0 ...`` and ``last_input_0 ...``; ``notes`` says in
    sentences what a receding horizon had to change.
    """

    problem: Problem
    notes: tuple[str, ...]

    @classmethod
    def of(cls, problem: Problem) -> Receding:
        """Make a receding problem.

        Raises :class:`~ocp.errors.InputError` for a free final time, which has no fixed sample.
        """
        if problem.h is not None:
            raise InputError(
                f"{problem.name}: the step size is free, and a controller needs a fixed one; build"
                " the problem with a number for h"
            )
        notes: list[str] = []
        changes: dict[str, Any] = {"start": None, "terminal": (), "scenarios": Scenarios()}
        if problem.start is not None:
            notes.append("The start is measured, not chosen; periodicity is left out.")
        if problem.scenarios.n > 1:
            notes.append(f"The measured state replaces the {problem.scenarios.n} scenarios.")
        if problem.terminal:
            names = ", ".join(constraint.name for constraint in problem.terminal)
            notes.append(f"Terminal constraints ({names}) are softened.")
            changes["terminal_cost"] = problem.terminal_cost + _softened(problem)
        defaults = problem.parameters.values
        x0, last_input = (np.array(v).ravel() for v in problem.limits(defaults)[:2])
        measured = [Parameter(f"measured_{i}", v, "1", "measured state") for i, v in enumerate(x0)]
        input_parameters = [Parameter(f"last_input_{i}", v, "1", "input before") for i, v in enumerate(last_input)]
        added = ParameterTable([*measured, *input_parameters])
        changes["x0"] = added.vector[: len(measured)]
        if problem.uses_du:
            changes["u_before"] = added.vector[len(measured) :]
        changed = replace(problem, parameters=problem.parameters + added, **changes)
        return cls(changed, tuple(notes))

    @cached_property
    def added(self) -> list[str]:
        """Names of the parameters that hold the measured state and the last input."""
        nx, nu = self.problem.system.nx, self.problem.system.nu
        return self.problem.parameters.names[-(nx + nu) :]


def _softened(problem: Problem) -> ca.SX:
    """Return 100 characteristic costs times the squared violation of terminal constraints."""
    violation = ca.SX(0)
    for constraint in problem.terminal:
        above, below = constraint.expression - constraint.upper, constraint.lower - constraint.expression
        violation += ca.sumsqr(ca.fmax(above, 0) + ca.fmax(below, 0))
    return TERMINAL_WEIGHT * problem.scales.cost / problem.natural_scales.x.max() ** 2 * violation


def horizon_rows(
    receding: Receding, names: list[str], base: np.ndarray, values: Values, dynamics: set[str]
) -> np.ndarray:
    """Return parameters as rows (N+1, np), one per step and one for the end, from ``base`` (np,).

    ``dynamics`` are the names that the step depends on, which have one value over a horizon.

    Raises :class:`~ocp.errors.InputError` for an unknown name, and for an array of another length
    or of a parameter of the dynamics.
    """
    N, allowed = receding.problem.N, [n for n in names if n not in receding.added]
    rows = np.tile(base, (N + 1, 1))
    for name, value in values.items():
        if name not in allowed:
            raise InputError(f"{receding.problem.name} has no parameter {name!r}{did_you_mean(name, allowed)}")
        values_of_name, i = numbers(name, value, finite=True), names.index(name)
        if values_of_name.ndim == 0:
            rows[:, i] = values_of_name
            continue
        if values_of_name.shape not in ((N,), (N + 1,)):
            raise InputError(
                f"{name} over the horizon needs {N} or {N + 1} values, got an array {values_of_name.shape}"
            )
        if name in dynamics and np.ptp(values_of_name) > 0:
            raise InputError(
                f"{name} is a parameter of the dynamics, which has one value over the horizon; give a number"
            )
        rows[: len(values_of_name), i], rows[len(values_of_name) :, i] = values_of_name, values_of_name[-1]
    return rows
