"""Gains over scenarios: the best of a regulator's gains, improved for friction, masses and step sizes together."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ocp.judge.disturbances import NOISE_SHARE, measured_sizes
from ocp.judge.referee import Referee, referee_replay
from ocp.mpc.plan_policies import PlanRegulator
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import Gains, Rollout
from ocp.solve.best_gains import WEIGHTS
from ocp.solve.scenario_outcomes import ScenarioOutcomes
from ocp.solve.shared_gains import Deviations, Expansion, shared_gains

PASSES = 12
"""Maximum number of passes of dynamic programming."""
STEP_LENGTHS = (1.0, 0.5, 0.25, 0.1)
"""Fractions of the change of the gains that are tried, in this order."""
DAMPINGS = (1e-3, 1e-2, 0.1, 1.0)
"""Weights of changes of inputs by their sizes, relative to the cost of a step; one that is too small gives the next."""
LEAST_DECREASE = 1e-4
"""Relative decrease of the mean cost below which a pass is the last."""


class PolicyOutcomes(Protocol):
    """Interface of motions under gains along a plan: how good they are, and their expansions."""

    problem: Problem
    evaluation: Evaluation
    plan: Rollout

    def merit(self, gains: Gains) -> tuple[int, int, float]:
        """Return two numbers of failures and a cost; smaller is better, in this order."""
        ...

    def expansions(self, gains: Gains) -> list[Expansion]:
        """Return the expansions of the motions that end."""
        ...


def gains_over_scenarios(
    evaluation: Evaluation, plan: Rollout, present_gains: Gains | None = None
) -> tuple[Gains, Referee]:
    """Return gains with fewer failures, and then a lower mean cost, over scenarios, and the referee's replay of them.

    The passes of :func:`~ocp.solve.shared_gains.shared_gains` start at the best of ``present_gains`` and the gains of
    :class:`~ocp.mpc.plan_policies.PlanRegulator` with :data:`~ocp.solve.best_gains.WEIGHTS`. States deviate as the
    referee's noise.
    """
    outcomes = ScenarioOutcomes(evaluation, plan)
    regulator = PlanRegulator(evaluation, plan)
    candidates = [regulator.gains(weights) for weights in WEIGHTS]
    candidates += [] if present_gains is None else [present_gains]
    merits = [outcomes.merit(gains) for gains in candidates]
    first = min(range(len(candidates)), key=merits.__getitem__)
    gains = improved_gains(outcomes, candidates[first], merits[first])
    return gains, referee_replay(evaluation, gains, plan.x[:, 0])


def improved_gains(outcomes: PolicyOutcomes, gains: Gains, merit: tuple[int, int, float]) -> Gains:
    """Return gains after passes with growing damping, each shortened until the merit decreases."""
    problem, evaluation, plan = outcomes.problem, outcomes.evaluation, outcomes.plan
    noise = np.diag((NOISE_SHARE * measured_sizes(problem)) ** 2)
    deviations = Deviations(noise, noise, noise / problem.N)
    unit = abs(plan.cost - evaluation.least_cost) / problem.N / problem.scales.u**2
    dampings, expansions = list(DAMPINGS), outcomes.expansions(gains)
    for _ in range(PASSES):
        if not (expansions and dampings):
            break
        improved = shared_gains(expansions, gains, deviations, np.diag(dampings[0] * unit), problem.scales.x)
        trials = (_between(gains, improved, length) for length in STEP_LENGTHS)
        better = next(((trial, new) for trial in trials if (new := outcomes.merit(trial)) < merit), None)
        if better is None:
            dampings.pop(0)
            continue
        previous, (gains, merit) = merit, better
        if merit[:2] == previous[:2] and previous[2] - merit[2] < LEAST_DECREASE * abs(merit[2]):
            break
        expansions = outcomes.expansions(gains)
    return gains


def _between(gains: Gains, improved: Gains, share: float) -> Gains:
    return Gains(gains.K + share * (improved.K - gains.K), gains.k + share * (improved.k - gains.k))
