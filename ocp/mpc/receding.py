"""Problem of a receding horizon whose start and last input are parameters."""

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
"""Weight of softened terminal constraints, in characteristic costs per squared characteristic size."""

Values = Mapping[str, "float | np.ndarray"]
"""Mapping from parameters to numbers or to arrays (N,) or (N+1,) with one value per step of the horizon."""


@dataclass(frozen=True)
class Receding:
    """Problem whose measured state and last input are parameters ``measured_0 ...`` and ``last_input_0 ...``.

    ``notes`` are sentences on how the original problem was changed for a receding horizon.
    """

    problem: Problem
    notes: tuple[str, ...]

    @classmethod
    def of(cls, problem: Problem) -> Receding:
        """Build the receding-horizon version of ``problem``.

        Raises :class:`~ocp.errors.InputError` if the step size is free, since a controller needs a fixed step size.
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
            changes["terminal_cost"] = problem.terminal_cost + _terminal_penalty(problem)
        defaults = problem.parameters.values
        x0, last_input = (np.array(v).ravel() for v in problem.limits(defaults)[:2])
        measured = [Parameter(f"measured_{i}", v, "1", "measured state") for i, v in enumerate(x0)]
        input_parameters = [Parameter(f"last_input_{i}", v, "1", "last input") for i, v in enumerate(last_input)]
        added = ParameterTable([*measured, *input_parameters])
        changes["x0"] = added.vector[: len(measured)]
        if problem.uses_du:
            changes["u_before"] = added.vector[len(measured) :]
        changed = replace(problem, parameters=problem.parameters + added, **changes)
        return cls(changed, tuple(notes))

    @cached_property
    def added(self) -> list[str]:
        """Names of the parameters for the measured state and the last input."""
        nx, nu = self.problem.system.nx, self.problem.system.nu
        return self.problem.parameters.names[-(nx + nu) :]


def _terminal_penalty(problem: Problem) -> ca.SX:
    """Return the terminal cost that replaces terminal constraints: the squared violation times a weight."""
    violation = ca.SX(0)
    for constraint in problem.terminal:
        above, below = constraint.expression - constraint.upper, constraint.lower - constraint.expression
        violation += ca.sumsqr(ca.fmax(above, 0) + ca.fmax(below, 0))
    return TERMINAL_WEIGHT * problem.scales.cost / problem.natural_scales.x.max() ** 2 * violation


def horizon_rows(
    receding: Receding, names: list[str], base: np.ndarray, values: Values, dynamics: set[str]
) -> np.ndarray:
    """Return the parameters over a horizon (N+1, np): ``base`` (np,) with the given values replaced.

    ``dynamics`` are the names of the parameters on which the step depends; they must be constant over the
    horizon.

    Raises :class:`~ocp.errors.InputError` for an unknown name, an array of another length, and a varying array
    for a parameter of the dynamics.
    """
    N, rows = receding.problem.N, np.empty((receding.problem.N + 1, len(base)))
    rows[:] = base
    for name, value in values.items():
        if name not in names or name in receding.added:
            allowed = [n for n in names if n not in receding.added]
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
