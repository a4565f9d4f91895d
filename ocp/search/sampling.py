"""Plans from nothing: the cross-entropy method over input sequences, rolled out by the batch engine.

A sequence of inputs is ``u = clip(B z, u_lower, u_upper)``, with B (N, K) a basis of K knots and z (K, nu) drawn
from a normal distribution. Each round rolls all samples out and fits the distribution to the cheapest tenth.
Several runs differ in the law, the basis and where they begin, since none of them is the best on all problems:
the exact law has no gradient from afar but needs none, and the barrier law narrows from a force at a distance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import casadi as ca
import numpy as np

from dynamics.batch import RolloutFunction, open_loop
from dynamics.contact import Barrier, ContactLaw, Exact, Step
from ocp.problem.batch_rollouts import batch_rollouts
from ocp.problem.evaluation import Evaluation
from ocp.problem.parts import Constraint
from ocp.problem.problem import Problem

ROUNDS = 40
"""Rounds of a run, after which the distribution is narrow."""
MAX_SAMPLES = 1000
"""Most samples of a round."""
MIN_SAMPLES = 64
"""Fewest samples of a round with which a distribution can be fitted."""
BUDGET = 2e7
"""Steps of one contact pair of all runs together: a step's work grows with the square of its pairs."""
ELITE_SHARE = 0.1
"""Share of a round's samples that the next distribution is fitted to."""
SMOOTHING = 0.2
"""Weight of the old mean and deviation in the new ones."""
KNOTS = (5, 8, 16)
"""Knots of the bases of input sequences."""
UNBOUNDED_REACH = 3.0
"""Deviation of an input without bounds, in characteristic sizes."""
BARRIER_DECADES = 4
"""Decades over which a run under the barrier law narrows mu, from the product of characteristic sizes."""
PENALTY_WEIGHT = 100.0
"""Cost of violating a constraint of states by its characteristic size, in characteristic costs."""

Basis = Literal["linear", "constant"]


def input_basis(basis: Basis, N: int, knots: int) -> np.ndarray:
    """Return the weights (N, knots) of piecewise constant or linear interpolation of N inputs."""
    if basis == "constant":
        return np.eye(knots)[np.arange(N) * knots // N]
    position = np.linspace(0, knots - 1, N)
    return np.maximum(0.0, 1.0 - np.abs(position[:, None] - np.arange(knots)))


@dataclass(frozen=True)
class SampledPlan:
    """The cheapest inputs (N, nu) of a run, their cost with penalties, and the run in words."""

    inputs: np.ndarray
    cost: float
    run: str


def can_sample(problem: Problem) -> bool:
    """Return whether inputs alone, from one given state, determine a plan."""
    return problem.scenarios.n == 1 and problem.start is None and problem.system.nu > 0


class InputSampler:
    """Runs of the cross-entropy method on the inputs of a problem that :func:`can_sample` takes.

    Bounds of states and constraints in states and inputs cost :data:`PENALTY_WEIGHT` by violation.
    ``samples`` are those of a round, ``rolled_steps`` the steps rolled out so far. Same ``seed``, same plans, whatever
    the number of threads.
    """

    def __init__(self, evaluation: Evaluation, seed: int = 0) -> None:
        problem, limits = evaluation.problem, evaluation.limits
        self.problem, self.evaluation, self.seed = penalized(problem), evaluation, seed
        self.lower, self.upper = limits.u_lower, limits.u_upper
        guess, size = evaluation.initial_guess[1].mean(axis=0), problem.scales.u
        bounded = np.isfinite(self.upper - self.lower)
        with np.errstate(invalid="ignore"):
            centre = np.where(bounded, (self.lower + self.upper) / 2, guess)
            reach = np.where(bounded, (self.upper - self.lower) / 2, UNBOUNDED_REACH * size)
        self.beginnings = {"bounds": (centre, reach), "guess": (guess, np.minimum(size, reach))}
        knots = sorted({min(knots, problem.N) for knots in KNOTS})
        self.runs = [*product((Exact(), Barrier(mu=1.0)), ("linear", "constant"), knots, self.beginnings)]
        pairs = max(problem.system.nlam, 2)
        affordable = BUDGET / (pairs**2 * problem.N * ROUNDS * len(self.runs))
        self.samples = int(np.clip(affordable, MIN_SAMPLES, MAX_SAMPLES))
        self.rolled_steps = 0
        self._functions: dict[str, tuple[Step, RolloutFunction]] = {}

    def plans(self) -> Iterator[SampledPlan]:
        """Yield the cheapest plan of each run, where its cost is finite."""
        streams = np.random.SeedSequence(self.seed).spawn(len(self.runs))
        for (law, basis, knots, beginning), stream in zip(self.runs, streams, strict=True):
            weights = input_basis(basis, self.problem.N, knots)
            generator = np.random.default_rng(stream)
            inputs, cost = self._run(*self._function(law), weights, self.beginnings[beginning], generator)
            if np.isfinite(cost):
                yield SampledPlan(inputs, cost, f"{law.name} law, {knots} {basis} pieces from the {beginning}")

    def exact_cost(self, inputs: np.ndarray) -> float:
        """Return the cost of inputs (N, nu) under the exact law, with penalties."""
        step, function = self._function(Exact())
        return float(self._costs(function, inputs[None], self._parameters(step, 1.0))[0])

    def _function(self, law: ContactLaw) -> tuple[Step, RolloutFunction]:
        """Return the step under a law and the function that rolls it out, compiled once."""
        if law.name not in self._functions:
            system = self.problem.system
            step = law.close(replace(system, parameters=self.problem.parameters))
            self._functions[law.name] = step, batch_rollouts(self.problem, step, open_loop(system.nx, system.nu))
        return self._functions[law.name]

    def _run(
        self,
        step: Step,
        function: RolloutFunction,
        weights: np.ndarray,
        beginning: tuple[np.ndarray, np.ndarray],
        generator: np.random.Generator,
    ) -> tuple[np.ndarray, float]:
        """Return the inputs of the cheapest sample of one run, (N, nu), and its cost."""
        knots = weights.shape[1]
        mean, deviation = (np.tile(part, (knots, 1)) for part in beginning)
        best, best_cost = mean, np.inf
        elites = max(4, int(ELITE_SHARE * self.samples))
        narrowing = len(step.p.names) > len(self.problem.parameters.names)
        for number in range(ROUNDS):
            z = mean + deviation * generator.standard_normal((self.samples, *mean.shape))
            z[0], z[1] = best, mean
            costs = self._costs(function, weights @ z, self._parameters(step, number / (ROUNDS - 1)))
            order = np.argsort(costs, kind="stable")[:elites]
            # Costs under a narrower barrier are others: the best of the last round is compared anew.
            if costs[order[0]] < best_cost or narrowing:
                best, best_cost = z[order[0]], float(costs[order[0]])
            mean = SMOOTHING * mean + (1 - SMOOTHING) * z[order].mean(axis=0)
            deviation = SMOOTHING * deviation + (1 - SMOOTHING) * z[order].std(axis=0)
        return np.clip(weights @ best, self.lower, self.upper), best_cost

    def _parameters(self, step: Step, progress: float) -> np.ndarray:
        """Return the values of a step's parameters, the barrier's mu as narrow as ``progress`` in [0, 1] tells."""
        sizes = self.problem.scales
        mu = sizes.impulse * sizes.gap * 10 ** (-BARRIER_DECADES * progress)
        values = self.evaluation.values
        return step.p.pack({**values, "contact.mu": mu} if "contact.mu" in step.p.names else values)

    def _costs(self, function: RolloutFunction, inputs: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Return the costs (S,) of clipped inputs (S, N, nu); infinite where a step is not solved."""
        limits, clipped = self.evaluation.limits, np.clip(inputs, self.lower, self.upper)
        self.rolled_steps += clipped.shape[0] * clipped.shape[1]
        rollouts = function(
            self.evaluation.initial_states[0],
            clipped,
            parameters,
            n_samples=len(inputs),
            u_before=limits.u_before if self.problem.uses_du else None,
            gradient=False,
        )
        return np.where(np.isfinite(rollouts.cost), rollouts.cost, np.inf)


def penalized(problem: Problem) -> Problem:
    """Return the problem with violations of state bounds and constraints as costs.

    Rollouts know no constraints. Those in the next state or in impulses are left to the solver.
    """
    system = problem.system
    bounds = Constraint("bounds", system.x, problem.x_lower, problem.x_upper)
    known = ca.vertcat(system.x, system.u, problem.parameters.vector)
    path = [c for c in problem.path if set(map(str, ca.symvar(c.expression))) <= set(map(str, ca.symvar(known)))]
    weight = PENALTY_WEIGHT * problem.scales.cost
    stage = sum((_violation(c, problem) for c in (bounds, *path)), ca.SX(0))
    terminal = sum((_violation(c, problem) for c in (bounds, *problem.terminal)), ca.SX(0))
    return replace(
        problem,
        stage_cost=problem.stage_cost + weight * stage,
        terminal_cost=problem.terminal_cost + weight * terminal,
        path=(),
        terminal=(),
        swept=False,
    )


def _violation(constraint: Constraint, problem: Problem) -> ca.SX:
    """Return the sum of violations, each in what states and inputs change by as they move by their sizes."""
    x, u, expression = problem.system.x, problem.system.u, constraint.expression
    sizes = (
        ca.fabs(ca.jacobian(expression, x)) @ problem.scales.x + ca.fabs(ca.jacobian(expression, u)) @ problem.scales.u
    )
    excess = ca.fmax(constraint.lower - expression, 0) + ca.fmax(expression - constraint.upper, 0)
    return ca.sum1(excess / ca.fmax(sizes, 1e-12))
