"""Path constraints and bounds on states as inequality rows of a plan, softened by a penalty."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from ocp.judge.constraints import Broken, Violation, row_sizes
from ocp.problem.parts import repeat_bound
from ocp.problem.problem import Problem
from ocp.transcription.common import constraint_names

PENALTIES = (1e3, 1e4, 1e5, 1e6)
"""Penalties of a slack [characteristic costs / size], tried in order while each reduces the violation by 1 %."""
MET_TOLERANCE = 1e-6
"""Violation, in characteristic sizes, up to which a row counts as satisfied."""
PENALTY_FALL = 0.99
"""Ratio of violations under successive penalties below which the larger penalty is accepted."""


@dataclass(frozen=True)
class ConstraintRows:
    """Path constraints and bounds on x_next as ``expression >= 0`` with m scaled rows.

    Each row is divided by its characteristic size in ``sizes`` (m,). The size of a bound is the characteristic
    size of the state; the size of a path constraint is its first-order change near the start when states and
    inputs change by their sizes. ``kinds`` (m,) are ``bound on x`` or ``path``; ``names`` (m,) are names of
    states and of constraints.
    """

    expression: ca.SX
    kinds: tuple[str, ...]
    names: tuple[str, ...]
    sizes: np.ndarray

    @classmethod
    def of(cls, problem: Problem) -> ConstraintRows:
        """Build the rows of a problem, without rows for infinite bounds."""
        system, path = problem.system, problem.path
        value = ca.vertcat(*(constraint.expression for constraint in path), system.x_next)
        names = [
            *(("path", name) for name in constraint_names(path)),
            *(("bound on x", signal.name) for signal in system.states),
        ]
        sizes = np.concatenate([_path_sizes(problem), problem.scales.x])
        bounds = [repeat_bound(bound, system.nx) for bound in (problem.x_lower, problem.x_upper)]
        ends = [
            ca.vertcat(*(getattr(constraint, side) for constraint in path), bound)
            for side, bound in zip(("lower", "upper"), bounds, strict=True)
        ]
        rows = [
            (sign * (value[i] - end[i]) / sizes[i], i)
            for sign, end in zip((1, -1), ends, strict=True)
            for i in range(value.numel())
            if not (end[i].is_constant() and np.isinf(float(end[i])))
        ]
        indices = [i for _, i in rows]
        expression = ca.vertcat(ca.SX(0, 1), *(row for row, _ in rows))
        kinds, signal_names = (tuple(names[i][column] for i in indices) for column in (0, 1))
        return cls(expression, kinds, signal_names, sizes[indices])

    def violations(self, amounts: np.ndarray) -> list[Broken]:
        """Return each violated constraint at its worst step, largest first, from violations ``amounts`` (S, N, m)."""
        worst = dict[tuple[str, str], Broken]()
        if not (amounts > MET_TOLERANCE).any():
            return []
        amounts = np.nan_to_num(amounts, nan=0.0)
        for i in np.argsort(-amounts.max(axis=(0, 1), initial=0.0), kind="stable"):
            s, k = divmod(int(amounts[:, :, i].argmax()), amounts.shape[1])
            name, amount = (self.kinds[i], self.names[i]), float(amounts[s, k, i])
            if amount > MET_TOLERANCE:
                violation = Violation(*name, s, k, amount * float(self.sizes[i]))
                worst.setdefault(name, Broken(violation, amount))
        return list(worst.values())


def _path_sizes(problem: Problem) -> np.ndarray:
    """Return sizes of path constraints, from slopes at the start and at one characteristic size; 1 for zero slopes."""
    scales, p = problem.scales, problem.parameters
    path = ca.vertcat(ca.SX(0, 1), *(constraint.expression for constraint in problem.path))
    x, u = (np.array(v).ravel() for v in problem.limits(p.values)[:2])
    size = ca.Function("sizes", problem.step_symbols, [row_sizes(problem, path, scales.x)])
    x, u = x + scales.x, u + scales.u
    sizes = np.array(size(x, u, x, scales.impulse, p.values)).ravel()
    return np.where(np.isfinite(sizes) & (sizes > 0), sizes, 1.0)
