"""Sampled plans: distributions of input sequences, rolled out by the batch engine, round by round.

A sequence of inputs is ``u = clip(B z, u_lower, u_upper)``, with B (N, K) a basis of K knots and samples z (K, nu).
Runs differ in the method, the law, the basis and the initial distribution, since no choice is best for all problems
(:mod:`ocp.search.sampling_runs`). The exact law has no gradient away from contact, but sampling does not need
gradients; the barrier law starts with forces at a distance.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache, partial
from itertools import product
from typing import get_args

import numpy as np

from dynamics.batch import BatchWarning, RolloutFunction, open_loop
from dynamics.contact import Barrier, ContactLaw, Exact, Step
from ocp.problem.batch_rollouts import batch_rollouts
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.search.penalties import TransitionPenalty, penalized
from ocp.search.sampling_runs import (
    AdaptedRun,
    Basis,
    CrossEntropyRun,
    Narrowing,
    SampledPlan,
    SamplingRun,
    input_basis,
)

MAX_SAMPLES = 1000
"""Maximum number of samples in each of :data:`FEW_ROUNDS`, unless the user states the number of steps."""
MIN_SAMPLES = 96
"""Minimum number of samples in a round, enough to fit a distribution to."""
STAGES = 4
"""Number of stages of equal length, after each of which the more expensive half of the runs ends."""
PAIR_STEPS = 1e8
"""Budget of cross-entropy runs: number of steps times the squared number of contact pairs, a measure of their work."""
ADAPTED_SHARE = 3.0
"""Budget of runs with covariance adaptation, as a multiple of that of cross-entropy runs."""
ADAPTED_SAMPLES = 40
"""Minimum number of samples in a round with covariance adaptation."""
MIN_ADAPTED_ROUNDS = 120
"""Minimum number of rounds with covariance adaptation."""
MAX_ADAPTED_ROUNDS = 400
"""Maximum number of rounds with covariance adaptation; a larger budget buys more samples in a round."""
AROUND_SHARE = 0.1
"""Standard deviation of every input around an answer, as a share of half the width of its bounds."""
KNOTS = (5, 8, 16)
"""Numbers of knots of the bases of input sequences."""
UNBOUNDED_REACH = 3.0
"""Initial standard deviation of an input without bounds, in characteristic sizes."""
BARRIER_DECADES = 4
"""Decades by which a run under the barrier law reduces mu from the characteristic impulse times gap."""

FEW_ROUNDS = Narrowing(40, 0.2)
"""Rounds for budgets of few samples."""
MANY_ROUNDS = Narrowing(120, 0.6)
"""Rounds for budgets of at least :data:`MIN_SAMPLES` samples in each of these rounds.

With the same number of samples in all, they end at plans of contact that cost less than those of :data:`FEW_ROUNDS`:
0.10 for 0.16, 0.0327 for 0.0345 and 0.37 for 0.60 on the tongs, the hammer and the maze of ``tests/strangers``.
"""
MU = "contact.mu"
"""Name of the barrier law's parameter mu."""


_Choice = tuple[ContactLaw, Basis, int, str]


def can_sample(problem: Problem) -> bool:
    """Return whether inputs alone determine a plan, with one scenario and a fixed start."""
    return problem.scenarios.n == 1 and problem.start is None and problem.system.nu > 0


class InputSampler:
    """Runs that sample the inputs of a problem for which :func:`can_sample` is true.

    All ``runs`` start: the cross-entropy method under every law, and, if ``adapts``, covariance adaptation under the
    first law; after every one of :data:`STAGES` stages the costlier half of each method under each law ends. Violated
    bounds and constraints cost as :mod:`ocp.search.penalties` says. The ``narrowing`` of each method follows from its
    budget: half of ``rollout_steps``, or :data:`PAIR_STEPS`, of which covariance adaptation has :data:`ADAPTED_SHARE`,
    with at most ``max_samples`` in each of :data:`FEW_ROUNDS`. ``rolled_steps`` counts the steps rolled out so far.
    Sampling ends if more than ``failing_share`` of the first run's samples have a step without solution, since such
    steps are slow. Plans depend on ``seed`` but not on the number of threads.
    """

    def __init__(
        self,
        evaluation: Evaluation,
        seed: int | Sequence[int] = 0,
        laws: Sequence[ContactLaw] = (Exact(), Barrier(mu=1.0)),
        failing_share: float = 1.0,
        rollout_steps: int | None = None,
        max_samples: int = MAX_SAMPLES,
        adapts: bool = True,
    ) -> None:
        problem, limits = evaluation.problem, evaluation.limits
        self.problem, self.evaluation, self.failing_share = penalized(problem), evaluation, failing_share
        self.adapts = adapts
        self.lower, self.upper = limits.u_lower, limits.u_upper
        guess, size = evaluation.initial_guess[1].mean(axis=0), problem.scales.u
        bounded = np.isfinite(self.upper - self.lower)
        with np.errstate(invalid="ignore"):
            centre = np.where(bounded, (self.lower + self.upper) / 2, guess)
            reach = np.where(bounded, (self.upper - self.lower) / 2, UNBOUNDED_REACH * size)
        self.reach = reach
        self._beginnings = {"bounds": (centre, reach), "guess": (guess, np.minimum(size, reach))}
        self.step_budget = rollout_steps or PAIR_STEPS / max(problem.system.nlam, 2) ** 2
        stated, most = rollout_steps is not None, math.inf if rollout_steps is not None else max_samples
        rollouts = self.step_budget / problem.N
        if stated and adapts:
            rollouts /= 2
        for knots in (KNOTS, KNOTS[:-1]):
            choices = self._choices(laws, knots)
            self.narrowing = _cross_entropy_rounds(rollouts / len(choices), most)
            # Where the budget does not allow all bases, more samples of fewer find more.
            if self.narrowing.samples > MIN_SAMPLES:
                break
        root = np.random.SeedSequence(seed)
        *streams, self._last_stream = root.spawn(len(choices) + 1)
        self.runs = self._create_runs(CrossEntropyRun, choices, streams, self.narrowing)
        if adapts:
            rollouts = max(self.step_budget / problem.N - self._rollouts(), 0.0) if stated else ADAPTED_SHARE * rollouts
            choices = self._choices(laws[:1], KNOTS[:-1])
            adapted = _adapted_rounds(rollouts / len(choices), 0 if stated else MIN_ADAPTED_ROUNDS, most)
            self.runs += self._create_runs(AdaptedRun, choices, root.spawn(len(choices)), adapted)
        self.rolled_steps = self.failures = 0
        self._transitions = TransitionPenalty.of_problem(evaluation)
        self._functions = _functions_of(problem)

    def _choices(self, laws: Sequence[ContactLaw], knots: Sequence[int]) -> list[_Choice]:
        """Return all choices of a law, a basis, its number of knots, and the initial distribution."""
        n_knots = sorted({min(n, self.problem.N) for n in knots})
        return [*product(laws, get_args(Basis), n_knots, self._beginnings)]

    def _create_runs(
        self,
        method: type[SamplingRun],
        choices: Sequence[_Choice],
        streams: Sequence[np.random.SeedSequence],
        narrowing: Narrowing,
    ) -> list[SamplingRun]:
        runs = list[SamplingRun]()
        for (law, basis, knots, beginning), stream in zip(choices, streams, strict=True):
            mean, deviation = (np.tile(row, (knots, 1)) for row in self._beginnings[beginning])
            name = f"{law.name} law, {knots} {basis} pieces from the {beginning}, {method.label}"
            weights, draws = input_basis(basis, self.problem.N, knots), np.random.default_rng(stream)
            runs.append(method(law, weights, mean, deviation, draws, narrowing, name))
        return runs

    def _rollouts(self) -> float:
        """Return the number of rollouts of all runs, of which half ends after every stage."""
        return sum(run.narrowing.samples * run.narrowing.rounds for run in self.runs) * 2 / STAGES

    def stages(self) -> Iterator[list[SampledPlan]]:
        """Yield after every stage the cheapest plan of each run with a finite cost."""
        running = self.runs
        for _ in range(STAGES):
            for run in running:
                run.advance(partial(self._costs, *self._function(run.law)), run.narrowing.rounds // STAGES)
                if run is self.runs[0] and self.failures > self.failing_share * run.narrowing.samples * run.rounds:
                    return
            yield [self._plan(run) for run in self.runs if np.isfinite(run.best_cost)]
            running = _cheaper_half(running)

    def around(self, inputs: np.ndarray, rounds: int) -> SampledPlan:
        """Return the cheapest plan of a run that changes every input of a plan (N, nu), by the exact law."""
        deviation = np.tile(AROUND_SHARE * self.reach, (len(inputs), 1))
        mean, name = np.zeros_like(deviation), "exact law, every input, around the answer"
        narrowing = replace(self.narrowing, samples=2 * self.narrowing.samples)
        draws, weights = np.random.default_rng(self._last_stream), np.eye(len(inputs))
        run = CrossEntropyRun(Exact(), weights, mean, deviation, draws, narrowing, name, inputs)
        run.advance(partial(self._costs, *self._function(run.law)), rounds)
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
        """Return the step under a law, and its compiled rollout function, which all samplers of a problem share."""
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
        if rollouts.states is not None:
            costs[finite] += self.transition_penalties(rollouts.states[finite], clipped[finite])
        return costs

    def transition_penalties(self, states: np.ndarray, inputs: np.ndarray) -> np.ndarray | float:
        """Return the penalties (S,) of transitions of trajectories (S, N + 1, nx) and (S, N, nu); 0 if it has none."""
        return 0.0 if self._transitions is None else self._transitions(states, inputs)


@contextmanager
def _quietly() -> Iterator[None]:
    """Hide warnings of the batch engine: samples may fail, and NumPy is fast enough without a C compiler."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BatchWarning)
        yield


@lru_cache(maxsize=4)
def _functions_of(problem: Problem) -> dict[str, tuple[Step, RolloutFunction]]:
    """Return the steps and rollout functions of a problem by the name of their law, empty at first."""
    return {}


def _cross_entropy_rounds(rollouts: float, most: float) -> Narrowing:
    """Return the narrowing of a run with a number of ``rollouts``, with at most ``most`` samples in a round."""
    # With halving, all stages together run at most twice the rounds of the first.
    samples = int(np.clip(rollouts * STAGES / 2 / FEW_ROUNDS.rounds, MIN_SAMPLES, most))
    in_many_rounds = samples * FEW_ROUNDS.rounds // MANY_ROUNDS.rounds
    if in_many_rounds >= MIN_SAMPLES:
        return replace(MANY_ROUNDS, samples=in_many_rounds)
    return replace(FEW_ROUNDS, samples=samples)


def _adapted_rounds(rollouts: float, min_rounds: int, most: float) -> Narrowing:
    """Return the narrowing of a run with covariance adaptation: few samples in a round, and many rounds."""
    in_all = rollouts * STAGES / 2
    rounds = int(np.clip(in_all / ADAPTED_SAMPLES, max(min_rounds, STAGES), MAX_ADAPTED_ROUNDS))
    return Narrowing(rounds, samples=int(np.clip(in_all / rounds, ADAPTED_SAMPLES, max(most / 10, ADAPTED_SAMPLES))))


def _cheaper_half(runs: list[SamplingRun]) -> list[SamplingRun]:
    """Return the cheaper half of the runs of each method under each law, whose costs cannot be compared."""
    chosen = set[int]()
    for kind in {(type(run), run.law.name) for run in runs}:
        same = sorted((run for run in runs if (type(run), run.law.name) == kind), key=lambda run: run.best_cost)
        chosen |= {id(run) for run in same[: -(-len(same) // 2)]}
    return [run for run in runs if id(run) in chosen]
