"""A problem at parameter values, with the quantities that depend on both, each evaluated only once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from dynamics.contact import Step
from ocp.problem.cost_sizes import least_value
from ocp.problem.problem import Problem

LEAST_COST = 1e-9
"""Minimum cost, in characteristic costs, that changes of cost are divided by."""


class Limits(NamedTuple):
    """Start and bounds of a problem for states (nx,) and inputs (nu,); ``u_before`` is the input before step 0."""

    x0: np.ndarray
    u_before: np.ndarray
    u_lower: np.ndarray
    u_upper: np.ndarray
    x_lower: np.ndarray
    x_upper: np.ndarray


def at_steps(function: ca.Function, *arrays: np.ndarray, p: np.ndarray) -> list[np.ndarray]:
    """Return the outputs (S, N, .) of ``function(*columns, p)`` at every scenario and step of arrays (S, N, .)."""
    S, N = arrays[0].shape[:2]
    columns = [ca.DM(array.reshape(S * N, array.shape[2]).T) for array in arrays]
    outputs = function.map(S * N).call([*columns, ca.DM(p)])
    return [np.array(output).T.reshape(S, N, output.shape[0]) for output in outputs]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """A ``problem`` at ``values``, a dict from the parameters of the problem and its law to numbers.

    Trajectories are x (S, N+1, nx), u (S, N, nu), and impulses (S, N, nlam) of the contacts of the problem's system.
    """

    problem: Problem
    values: dict[str, float]

    @cached_property
    def p(self) -> np.ndarray:
        """Values (np,) of the problem's parameters in their order."""
        return self.problem.parameters.pack(self.values)

    @cached_property
    def limits(self) -> Limits:
        """Start and bounds of the problem."""
        return Limits(*(np.array(limit).ravel() for limit in self.problem.limits(self.p)))

    @cached_property
    def start_limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds (nx,) of the first state; they are equal for a fixed start."""
        lower, upper = (np.array(limit).ravel() for limit in self.problem.start_limits(self.p))
        return lower, upper

    @cached_property
    def initial_states(self) -> np.ndarray:
        """Initial states (S, nx) of all scenarios."""
        return self.problem.initial_states(self.p)

    @cached_property
    def initial_guess(self) -> tuple[np.ndarray, np.ndarray]:
        """States (N+1, nx) and inputs (N, nu) of the problem's guess."""
        return self.problem.initial_guess(self.p)

    @cached_property
    def constant_cost(self) -> float:
        """Sum over the horizon of the cost's constant terms, which no plan can change."""
        problem = self.problem
        stage, terminal = (constant for _, constant in problem.split_costs)
        if stage.is_zero() and terminal.is_zero():
            return 0.0
        total = ca.Function("constant", [problem.parameters.vector], [problem.N * stage + terminal])
        return float(total(self.p))

    @cached_property
    def least_cost(self) -> float:
        """Lower bound of the cost: its constant terms, and the least value of terms such as ``sqrt(400 + x**2)``."""
        p = [self.problem.parameters.vector], [ca.DM(self.p)]
        stage, terminal = map(least_value, ca.substitute([*self.problem.changeable_costs], *p))
        return self.constant_cost + self.problem.N * max(stage, 0.0) + max(terminal, 0.0)

    def step_values(self, step: Step, with_law_values: bool = True) -> np.ndarray:
        """Return the parameter vector of a step, with the problem's parameters and those of the step's contact law.

        A law parameter is taken from ``values``, and from the law's settings if ``values`` does not contain it or if
        ``with_law_values`` is False.
        """
        if with_law_values:
            return step.p.pack(self.values)
        table = self.problem.parameters
        return step.p.pack({name: value for name, value in self.values.items() if name in table})

    def node_times(self, start: np.ndarray | None = None) -> np.ndarray:
        """Return the times [s] of the nodes, (N+1,).

        ``start`` (nx,) is the first state, which contains the step size if the step size is a state.
        """
        problem, first = self.problem, self.initial_states[0] if start is None else start
        h = ca.Function("h", [problem.system.x, problem.parameters.vector], [ca.SX(problem.system.h)])
        return float(h(first, self.p)) * np.arange(problem.N + 1)

    def trajectory_costs(self, x: np.ndarray, u: np.ndarray, impulses: np.ndarray) -> np.ndarray:
        """Return the costs (S,) of trajectories."""
        stage, terminal = self.cost_parts(x, u, impulses)
        return stage.sum(axis=(1, 2)) + terminal[:, 0, 0]

    def cost_parts(self, x: np.ndarray, u: np.ndarray, impulses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the stage costs (S, N, 1) and terminal costs (S, 1, 1) of trajectories."""
        u_before = self.limits.u_before
        du = np.diff(u, axis=1, prepend=np.broadcast_to(u_before, (len(u), 1, u_before.size)))
        stage, _ = at_steps(self.problem.cost_terms, x[:, :-1], u, du, impulses, p=self.p)
        last = (array[:, -1:] for array in (x, u, du, impulses))
        return stage, at_steps(self.problem.cost_terms, *last, p=self.p)[1]

    def cost_share(self, change: float, cost: float) -> float:
        """Return a ``change`` relative to the part of ``cost`` that a plan can change.

        This part is the cost minus :attr:`least_cost`, so that a constant in the cost changes no verdict; it is at
        least :data:`LEAST_COST` characteristic costs.
        """
        changeable = abs(cost - self.least_cost)
        return change / max(changeable, LEAST_COST * self.problem.scales.cost)

    def signed_distances(self, x: np.ndarray) -> np.ndarray | None:
        """Return the true signed distances phi (..., n_phi) [m] at states x (..., nx); None without geometry."""
        phi = self.problem.signed_distance
        if phi is None:
            return None
        if not phi.numel_out(0):
            return np.empty((*x.shape[:-1], 0))
        states = x.reshape(-1, x.shape[-1])
        return np.array(phi.map(len(states))(states.T, self.p)).T.reshape(*x.shape[:-1], -1)
