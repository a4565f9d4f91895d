"""Sampled plans: the cross-entropy method over input sequences, rolled out by the batch engine.

A sequence of inputs is ``u = clip(B z, u_lower, u_upper)``, with B (N, K) a basis of K knots and z (K, nu) drawn
from a normal distribution. Each round rolls all samples out and fits the distribution to the cheapest tenth.
Runs differ in the law, the basis and the initial distribution, since no choice is best for all problems. The exact
law has no gradient away from contact, but sampling does not need gradients; the barrier law starts with forces at a
distance.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Literal, get_args

import numpy as np

from dynamics.batch import BatchWarning, RolloutFunction, open_loop
from dynamics.contact import Barrier, ContactLaw, Exact, Step
from ocp.problem.batch_rollouts import batch_rollouts
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.search.penalties import TransitionPenalty, penalized

MAX_SAMPLES = 1000
"""Maximum number of samples in each of :data:`FEW_ROUNDS`, unless the user states the number of steps."""
MIN_SAMPLES = 96
"""Minimum number of samples in a round, enough to fit a distribution to."""
STAGES = 4
"""Number of stages of equal length, after each of which the more expensive half of the runs ends."""
PAIR_STEPS = 1e8
"""Budget of all runs: number of steps times the squared number of contact pairs, a measure of a step's work."""
ELITE_SHARE = 0.1
"""Fraction of a round's samples to which the next distribution is fitted."""
AROUND_SHARE = 0.1
"""Standard deviation of every input around an answer, as a share of half the width of its bounds."""
KNOTS = (5, 8, 16)
"""Numbers of knots of the bases of input sequences."""
UNBOUNDED_REACH = 3.0
"""Initial standard deviation of an input without bounds, in characteristic sizes."""
BARRIER_DECADES = 4
"""Decades by which a run under the barrier law reduces mu from the characteristic impulse times gap."""

MU = "contact.mu"
"""Name of the barrier law's parameter mu."""

Basis = Literal["linear", "constant"]


def input_basis(basis: Basis, N: int, knots: int) -> np.ndarray:
    """Return the weights (N, knots) that interpolate N inputs between knots, piecewise constant or linear."""
    if basis == "constant":
        return np.eye(knots)[np.arange(N) * knots // N]
    position = np.linspace(0, knots - 1, N)
    return np.maximum(0.0, 1.0 - np.abs(position[:, None] - np.arange(knots)))


@dataclass(frozen=True)
class Narrowing:
    """Number of ``rounds`` in which the distribution of a run becomes narrow.

    ``smoothing`` is the weight of the previous mean and deviation in the new ones.
    """

    rounds: int
    smoothing: float


FEW_ROUNDS = Narrowing(40, 0.2)
"""Rounds for budgets of few samples."""
MANY_ROUNDS = Narrowing(120, 0.6)
"""Rounds for budgets of at least :data:`MIN_SAMPLES` samples in each of these rounds.

With the same number of samples in all, they end at plans of contact that cost less than those of :data:`FEW_ROUNDS`:
0.10 for 0.16, 0.0327 for 0.0345 and 0.37 for 0.60 on the tongs, the hammer and the maze of ``tests/strangers``.
"""


@dataclass(frozen=True)
class SampledPlan:
    """The cheapest inputs (N, nu) of a run, their cost with penalties, and the run's name."""

    inputs: np.ndarray
    cost: float
    run: str


def can_sample(problem: Problem) -> bool:
    """Return whether inputs alone determine a plan, with one scenario and a fixed start."""
    return problem.scenarios.n == 1 and problem.start is None and problem.system.nu > 0


@dataclass(eq=False)
class SamplingRun:
    """One run of the cross-entropy method: its law, basis (N, K), and normal distribution (K, nu).

    ``best`` (K, nu) is its cheapest sample, with the cost ``best_cost``, after ``rounds`` of the ``narrowing``.
    """

    law: ContactLaw
    weights: np.ndarray
    mean: np.ndarray
    deviation: np.ndarray
    generator: np.random.Generator
    narrowing: Narrowing
    name: str
    best: np.ndarray
    offset: np.ndarray | float = 0.0
    best_cost: float = np.inf
    rounds: int = 0

    def inputs(self, z: np.ndarray) -> np.ndarray:
        """Return the inputs (..., N, nu) of samples (..., K, nu) before clipping."""
        return self.offset + self.weights @ z

    @property
    def narrows(self) -> bool:
        """Whether mu decreases from round to round, so that costs of different rounds cannot be compared."""
        return isinstance(self.law, Barrier)

    def advance(self, costs_of: Callable[[np.ndarray, float], np.ndarray], samples: int, rounds: int) -> None:
        """Fit the distribution to the cheapest samples, ``rounds`` times.

        ``costs_of`` maps inputs (S, N, nu) and the progress from 0 to 1 of the whole run to costs (S,).
        """
        elites = max(4, int(ELITE_SHARE * samples))
        smoothing, last = self.narrowing.smoothing, self.narrowing.rounds - 1
        for _ in range(rounds):
            z = self.mean + self.deviation * self.generator.standard_normal((samples, *self.mean.shape))
            z[0], z[1] = self.best, self.mean
            costs = costs_of(self.inputs(z), self.rounds / last)
            order = np.argsort(costs, kind="stable")[:elites]
            if costs[order[0]] < self.best_cost or self.narrows:
                self.best, self.best_cost = z[order[0]], float(costs[order[0]])
            self.mean = smoothing * self.mean + (1 - smoothing) * z[order].mean(axis=0)
            self.deviation = smoothing * self.deviation + (1 - smoothing) * z[order].std(axis=0)
            self.rounds += 1


class InputSampler:
    """Runs of the cross-entropy method on the inputs of a problem for which :func:`can_sample` is true.

    All ``runs`` start; after every one of :data:`STAGES` stages the costlier half under each law ends. Violated bounds
    and constraints cost as :mod:`ocp.search.penalties` says. The budget ``rollout_steps`` of steps, or
    :data:`PAIR_STEPS` and at most ``max_samples`` in each of :data:`FEW_ROUNDS`, determines the ``narrowing`` and the
    ``samples`` of a round; ``rolled_steps`` counts the steps rolled out so far.
    Sampling ends if more than ``failing_share`` of the first run's samples have a step without solution, since such
    steps are slow. Plans depend on ``seed`` but not on the number of threads.
    """

    def __init__(
        self,
        evaluation: Evaluation,
        seed: int = 0,
        laws: Sequence[ContactLaw] = (Exact(), Barrier(mu=1.0)),
        failing_share: float = 1.0,
        rollout_steps: int | None = None,
        max_samples: int = MAX_SAMPLES,
    ) -> None:
        problem, limits = evaluation.problem, evaluation.limits
        self.problem, self.evaluation, self.failing_share = penalized(problem), evaluation, failing_share
        self.lower, self.upper = limits.u_lower, limits.u_upper
        guess, size = evaluation.initial_guess[1].mean(axis=0), problem.scales.u
        bounded = np.isfinite(self.upper - self.lower)
        with np.errstate(invalid="ignore"):
            centre = np.where(bounded, (self.lower + self.upper) / 2, guess)
            reach = np.where(bounded, (self.upper - self.lower) / 2, UNBOUNDED_REACH * size)
        self.reach = reach
        beginnings = {"bounds": (centre, reach), "guess": (guess, np.minimum(size, reach))}
        # With halving, all stages together run at most twice the rounds of the first.
        self.step_budget = rollout_steps or PAIR_STEPS / max(problem.system.nlam, 2) ** 2
        affordable = self.step_budget / (problem.N * 2 * FEW_ROUNDS.rounds / STAGES)
        most = max_samples if rollout_steps is None else math.inf
        for knots in (KNOTS, KNOTS[:-1]):
            n_knots = sorted({min(n, problem.N) for n in knots})
            choices = [*product(laws, get_args(Basis), n_knots, beginnings)]
            samples = int(np.clip(affordable / len(choices), MIN_SAMPLES, most))
            # Where the budget does not allow all bases, more samples of fewer find more.
            if samples > MIN_SAMPLES:
                break
        in_many_rounds = samples * FEW_ROUNDS.rounds // MANY_ROUNDS.rounds
        self.narrowing = MANY_ROUNDS if in_many_rounds >= MIN_SAMPLES else FEW_ROUNDS
        self.samples = in_many_rounds if in_many_rounds >= MIN_SAMPLES else samples
        self.runs: list[SamplingRun] = []
        *streams, self._last_stream = np.random.SeedSequence(seed).spawn(len(choices) + 1)
        for (law, basis, knots, beginning), stream in zip(choices, streams, strict=True):
            mean, deviation = (np.tile(row, (knots, 1)) for row in beginnings[beginning])
            name = f"{law.name} law, {knots} {basis} pieces from the {beginning}"
            weights = input_basis(basis, problem.N, knots)
            draws = np.random.default_rng(stream)
            self.runs.append(SamplingRun(law, weights, mean, deviation, draws, self.narrowing, name, mean))
        self.rolled_steps = self.failures = 0
        self._transitions = TransitionPenalty.of_problem(evaluation)
        self._functions: dict[str, tuple[Step, RolloutFunction]] = {}

    def stages(self) -> Iterator[list[SampledPlan]]:
        """Yield after every stage the cheapest plan of each run with a finite cost."""
        running = self.runs
        for _ in range(STAGES):
            for run in running:
                costs_of = partial(self._costs, *self._function(run.law))
                run.advance(costs_of, self.samples, self.narrowing.rounds // STAGES)
                if run is self.runs[0] and self.failures > self.failing_share * self.samples * run.rounds:
                    return
            yield [self._plan(run) for run in self.runs if np.isfinite(run.best_cost)]
            running = _cheaper_half(running)

    def around(self, inputs: np.ndarray, rounds: int) -> SampledPlan:
        """Return the cheapest plan of a run that changes every input of a plan (N, nu), by the exact law."""
        deviation = np.tile(AROUND_SHARE * self.reach, (len(inputs), 1))
        mean, name = np.zeros_like(deviation), "exact law, every input, around the answer"
        draws = np.random.default_rng(self._last_stream)
        run = SamplingRun(Exact(), np.eye(len(inputs)), mean, deviation, draws, self.narrowing, name, mean, inputs)
        run.advance(partial(self._costs, *self._function(run.law)), 2 * self.samples, rounds)
        return self._plan(run)

    def _plan(self, run: SamplingRun) -> SampledPlan:
        return SampledPlan(np.clip(run.inputs(run.best), self.lower, self.upper), run.best_cost, run.name)

    def exact_cost(self, inputs: np.ndarray) -> float:
        """Return the cost of inputs (N, nu) under the exact law, with penalties."""
        return float(self.exact_costs(inputs[None])[0])

    def exact_costs(self, inputs: np.ndarray) -> np.ndarray:
        """Return the costs (S,) of inputs (S, N, nu) under the exact law, with penalties; infinite if a step fails."""
        return self._costs(*self._function(Exact()), inputs, 1.0)

    def _function(self, law: ContactLaw) -> tuple[Step, RolloutFunction]:
        """Return the step under a law, and its compiled rollout function from a cache."""
        if law.name not in self._functions:
            system = self.problem.system
            step = law.close(replace(system, parameters=self.problem.parameters))
            with _quietly():
                function = batch_rollouts(self.problem, step, open_loop(system.nx, system.nu))
            self._functions[law.name] = step, function
        return self._functions[law.name]

    def _costs(self, step: Step, function: RolloutFunction, inputs: np.ndarray, progress: float) -> np.ndarray:
        """Return the costs (S,) of clipped inputs (S, N, nu); infinite if a step is not solved.

        The barrier law's mu decreases as ``progress`` rises from 0 to 1.
        """
        sizes, values = self.problem.scales, self.evaluation.values
        if MU in step.p.names:
            values = {**values, MU: sizes.impulse * sizes.gap * 10 ** (-BARRIER_DECADES * progress)}
        clipped = np.clip(inputs, self.lower, self.upper)
        self.rolled_steps += clipped.shape[0] * clipped.shape[1]
        with _quietly():
            rollouts = function(
                self.evaluation.initial_states[0],
                clipped,
                step.p.pack(values),
                n_samples=len(inputs),
                u_before=self.evaluation.limits.u_before if self.problem.uses_du else None,
                gradient=False,
                states=self._transitions is not None,
            )
        finite = np.isfinite(rollouts.cost)
        self.failures += int(np.sum(~finite))
        costs = np.where(finite, rollouts.cost, np.inf)
        if self._transitions is not None and rollouts.states is not None:
            costs[finite] += self._transitions(rollouts.states[finite], clipped[finite])
        return costs


@contextmanager
def _quietly() -> Iterator[None]:
    """Hide warnings of the batch engine: samples may fail, and NumPy is fast enough without a C compiler."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BatchWarning)
        yield


def _cheaper_half(runs: list[SamplingRun]) -> list[SamplingRun]:
    """Return the cheaper half of the runs under each law, since costs under different laws cannot be compared."""
    chosen = set[int]()
    for law in {run.law.name for run in runs}:
        same = sorted((run for run in runs if run.law.name == law), key=lambda run: run.best_cost)
        chosen |= {id(run) for run in same[: -(-len(same) // 2)]}
    return [run for run in runs if id(run) in chosen]
