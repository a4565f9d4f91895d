"""Penalties for violated constraints in rollouts, which do not enforce constraints."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

import casadi as ca
import numpy as np

from dynamics.batch import BatchFunction
from ocp.judge.constraints import CONSTRAINT_SHARE
from ocp.problem.evaluation import Evaluation
from ocp.problem.parts import Constraint
from ocp.problem.problem import SWEPT, Problem

PENALTY_WEIGHT = 100.0
"""Cost, in characteristic costs, of violating a state constraint by its characteristic size."""
FREE_SHARE = CONSTRAINT_SHARE / 10
"""Violation without penalty, as a share of the characteristic size: replays of solved plans leave their bounds by less.

A tenth of what judging accepts. Without it a plan at its bounds costs more than its neighbours inside them.
"""


def penalized(problem: Problem) -> Problem:
    """Return the problem with violations of constraints on states and inputs, including bounds, added to the cost.

    Constraints on the next state are left to :class:`TransitionPenalty`, constraints on impulses to the solver.
    """
    system = problem.system
    bounds = Constraint("bounds", system.x, problem.x_lower, problem.x_upper)
    path = [row for row in problem.path if _symbols(row.expression) <= _symbols(_arguments(problem, system.x))]
    stage, terminal = (_violations(rows, problem) for rows in ((bounds, *path), (bounds, *problem.terminal)))
    return replace(
        problem,
        stage_cost=problem.stage_cost + stage,
        terminal_cost=problem.terminal_cost + terminal,
        path=(),
        terminal=(),
        swept=False,
    )


@dataclass(frozen=True)
class TransitionPenalty:
    """Penalty of trajectories for constraints on consecutive states and, in scenes, on motion between two nodes.

    ``function`` maps (x, u, x_next, p) to the penalty of one step; ``p`` are the values of the parameters.
    """

    function: BatchFunction
    p: np.ndarray

    @classmethod
    def of_problem(cls, evaluation: Evaluation) -> Self | None:
        """Return the penalty of a problem; None if it has no such constraint."""
        problem = evaluation.problem
        if problem.system.scene and problem.system.phi is not None:
            problem = replace(problem, swept=True)
        system = problem.system
        symbols = _arguments(problem, system.x, system.x_next)
        rows = [row for row in problem.path if ca.depends_on(row.expression, system.x_next)]
        rows = [row for row in rows if _symbols(row.expression) <= _symbols(symbols)]
        if not rows:
            return None
        arguments = [system.x, system.u, system.x_next, problem.parameters.vector]
        function = ca.Function("transition_penalty", arguments, [_violations(rows, problem)])
        return cls(BatchFunction(function, backend="numpy"), np.asarray(evaluation.p, dtype=float).ravel())

    def __call__(self, states: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        """Return the penalties (S,) of states (S, N + 1, nx) and inputs (S, N, nu)."""
        n_samples, n_steps, nu = inputs.shape
        before, after = (part.reshape(-1, states.shape[2]) for part in (states[:, :-1], states[:, 1:]))
        penalties = self.function(before, inputs.reshape(-1, nu), after, self.p)
        return penalties.reshape(n_samples, n_steps).sum(axis=1)


def _arguments(problem: Problem, *states: ca.SX) -> ca.SX:
    return ca.vertcat(*states, problem.system.u, problem.parameters.vector)


def _symbols(expression: ca.SX) -> set[str]:
    return set(map(str, ca.symvar(expression)))


def _violations(rows: Iterable[Constraint], problem: Problem) -> ca.SX:
    """Return the cost of all violations, each divided by its change when states and inputs change by their sizes.

    Penetration between nodes is divided by the characteristic gap. Shares up to :data:`FREE_SHARE` cost nothing.
    """
    system, total = problem.system, ca.SX(0)
    signals = ((system.x, problem.scales.x), (system.x_next, problem.scales.x), (system.u, problem.scales.u))
    for row in rows:
        changes = (ca.fabs(ca.jacobian(row.expression, symbol)) @ ca.DM(size) for symbol, size in signals)
        sizes = problem.scales.gap if row.name == SWEPT else sum(changes)
        excess = ca.fmax(row.lower - row.expression, 0) + ca.fmax(row.expression - row.upper, 0)
        total += ca.sum1(ca.fmax(excess / ca.fmax(sizes, 1e-12) - FREE_SHARE, 0))
    return PENALTY_WEIGHT * problem.scales.cost * total
