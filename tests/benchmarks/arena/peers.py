"""The published formulations, as plain scripts for IPOPT: an l1 penalty on products, or Scholtes' relaxation."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from ocp.problem.problem import Problem

SCHOLTES = tuple(10.0**-k for k in range(9))
"""Bounds on the products, one after the other [units of the pairs]."""
OPTIONS = {"print_time": False}
IPOPT = {"print_level": 0, "sb": "yes", "max_iter": 3000, "tol": 1e-8}
"""Options of IPOPT: those of the sources, with a tighter tolerance, since the judge asks for 1e-8."""
START = 0.01
"""First guess of every variable that is not a state, as in InteriorPointDDP's scripts."""


@dataclass(frozen=True)
class Answer:
    """States (N+1, nx), inputs (N, nu) and multipliers (N, nlam) in the workbench's variables; seconds of processor."""

    x: np.ndarray
    u: np.ndarray
    lam: np.ndarray
    cost: float
    converged: bool
    iterations: int
    seconds: float


@dataclass
class Script:
    """An Opti script: variables, a loop over the steps, and products that a penalty or a bound holds at zero."""

    weight: float = 0.0
    opti: ca.Opti = field(default_factory=ca.Opti)
    cost: ca.MX = field(default_factory=lambda: ca.MX(0))
    began: float = field(default_factory=time.process_time)

    def __post_init__(self) -> None:
        self.bound = None if self.weight else self.opti.parameter()

    def positive(self, n: int) -> ca.MX:
        """Return n variables >= 0."""
        value = self.opti.variable(n)
        self.opti.subject_to(value >= 0)
        self.opti.set_initial(value, START)
        return value

    def product(self, first: ca.MX, second: ca.MX) -> None:
        """Penalise the products of nonnegative sides, or bound them."""
        if self.weight:
            self.cost += self.weight * ca.dot(first, second)
        else:
            self.opti.subject_to(first * second <= self.bound)

    def solve(self, read: Callable[[Callable[[ca.MX], np.ndarray]], tuple[np.ndarray, ...]]) -> Answer:
        """Solve, in Scholtes' relaxation bound after bound, and read states, inputs and multipliers."""
        opti, iterations, converged = self.opti, 0, True
        opti.minimize(self.cost)
        opti.solver("ipopt", OPTIONS, IPOPT)
        for k, bound in enumerate((None,) if self.bound is None else SCHOLTES):
            if k:
                opti.set_initial(opti.x, opti.debug.value(opti.x))
            if self.bound is not None:
                opti.set_value(self.bound, bound)
            try:
                opti.solve()
                converged = True
            except RuntimeError:
                converged = False
            iterations += int(opti.debug.stats()["iter_count"])
        x, u, lam = read(lambda expression: np.array(opti.debug.value(expression), ndmin=2))
        seconds = time.process_time() - self.began
        return Answer(x, u, lam, float(opti.debug.value(self.cost)), converged, iterations, seconds)


def penalised(problem: Problem, weight: float = 0.0) -> Answer:
    """Solve the workbench's form of a task by a penalty of this ``weight``, or by Scholtes' relaxation if it is 0."""
    script, s, p = Script(weight), problem.system, problem.parameters.values
    opti, N = script.opti, problem.N
    rows = ca.vertcat(ca.SX(0, 1), *(row.expression for row in problem.path))
    step = ca.Function("step", problem.step_symbols, [s.residual, s.gap, rows])
    at_end = ca.vertcat(ca.SX(0, 1), *(row.expression for row in problem.terminal))
    end = ca.Function("end", [s.x, problem.parameters.vector], [at_end])
    limits = [
        np.array(ca.evalf(ca.substitute(ca.SX(value), problem.parameters.vector, p))) for value in _bounds(problem)
    ]
    x0, _, *box = (np.array(value).ravel() for value in problem.limits(p))
    X, U = opti.variable(s.nx, N + 1), opti.variable(s.nu, N)
    guessed_x, guessed_u = problem.initial_guess(p)
    opti.set_initial(X, guessed_x.T)
    opti.set_initial(U, guessed_u.T)
    opti.subject_to(X[:, 0] == x0)
    multipliers = []
    for k in range(N):
        lam, gap = script.positive(s.nlam), script.positive(s.nlam)
        residual, opening, path = step(X[:, k], U[:, k], X[:, k + 1], lam, p)
        opti.subject_to(residual == 0)
        opti.subject_to(gap == opening)
        script.product(lam, gap)
        _bounded(opti, path, *limits[:2])
        _bounded(opti, U[:, k], box[0], box[1])
        _bounded(opti, X[:, k + 1], box[2], box[3])
        script.cost += problem.cost_terms(X[:, k], U[:, k], 0, lam, p)[0]
        multipliers.append(lam)
    _bounded(opti, end(X[:, N], p), *limits[2:])
    script.cost += problem.cost_terms(X[:, N], 0, 0, 0, p)[1]
    return script.solve(lambda value: (value(X).T, value(U).reshape(s.nu, N).T, value(ca.horzcat(*multipliers)).T))


def _bounds(problem: Problem) -> list[ca.SX]:
    """Return lower and upper bounds of path constraints, then of terminal ones."""
    return [
        ca.vertcat(ca.SX(0, 1), *(getattr(row, side) for row in rows))
        for rows in (problem.path, problem.terminal)
        for side in ("lower", "upper")
    ]


def _bounded(opti: ca.Opti, value: ca.MX, lower: np.ndarray, upper: np.ndarray) -> None:
    """Add the bounds on each entry that are finite; equal bounds make an equation."""
    for i, (low, high) in enumerate(zip(np.ravel(lower), np.ravel(upper), strict=True)):
        if low == high:
            opti.subject_to(value[i] == low)
            continue
        if np.isfinite(low):
            opti.subject_to(value[i] >= low)
        if np.isfinite(high):
            opti.subject_to(value[i] <= high)
