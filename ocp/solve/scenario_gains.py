"""Gains over scenarios: the best of a regulator's gains, improved for friction, masses and step sizes together."""

from __future__ import annotations

from itertools import product
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
from ocp.solve.shared_gains import Deviations, Expansion, Merit, is_end_bound, shared_gains, with_bound_end

PASSES = 12
"""Maximum number of passes of dynamic programming."""
STEP_LENGTHS = (1.0, 0.5, 0.25, 0.1)
"""Fractions of the change of the gains that are tried, in this order."""
DAMPINGS = (1e-3, 1e-2, 0.1, 1.0)
"""Weights of changes of inputs by their sizes, relative to the cost of a step; one that is too small gives the next."""
NOISE_SHARES = (1.0, 1e-6)
"""Factors of the covariance of deviations; the second one if the motion at nominal parameters still fails.

Large deviations say more of the motions around it than of the motion itself: along the quadruped's plan only steps of a
thousandth of the change reduce the failure then, and of a tenth with the second factor. It still determines the gains.
"""
END_SHARES = (1.0, 10.0, 100.0)
"""Penalties of deviations from a bound end (:func:`~ocp.solve.shared_gains.with_bound_end`), each after the last."""
LEAST_DECREASE = 1e-4
"""Relative decrease of the mean cost below which a pass is the last."""


class PolicyOutcomes(Protocol):
    """Interface of motions under gains along a plan: how good they are, and their expansions."""

    problem: Problem
    evaluation: Evaluation
    plan: Rollout

    def merit(self, gains: Gains) -> Merit:
        """Return the failures and the cost of gains."""
        ...

    def expansions(self, gains: Gains, nominal: bool) -> list[Expansion]:
        """Return the expansions of the motions that end, or of those at ``nominal`` parameters only."""
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
    gains, _ = improved_gains(outcomes, candidates[first], merits[first])
    return gains, referee_replay(evaluation, gains, plan.x[:, 0])


def improved_gains(outcomes: PolicyOutcomes, gains: Gains, merit: Merit) -> tuple[Gains, Merit]:
    """Return gains and their merit after passes.

    While the policy fails, a bound end is penalised more, and then noise is reduced.
    """
    end_shares = END_SHARES if is_end_bound(outcomes.problem) else END_SHARES[:1]
    for noise_share, end_share in product(NOISE_SHARES, end_shares):
        gains, merit = _passes(outcomes, gains, merit, noise_share, end_share)
        if not merit.failures:
            break
    return gains, merit


def _passes(
    outcomes: PolicyOutcomes, gains: Gains, merit: Merit, noise_share: float, end_share: float
) -> tuple[Gains, Merit]:
    """Return gains and their merit after passes with growing damping, each shortened until the merit decreases."""
    problem, evaluation, plan = outcomes.problem, outcomes.evaluation, outcomes.plan
    noise = noise_share * np.diag((NOISE_SHARE * measured_sizes(problem)) ** 2)
    deviations = Deviations(noise, noise, noise / problem.N)
    unit = abs(plan.cost - evaluation.least_cost) / problem.N / problem.scales.u**2
    dampings, expansions = list(DAMPINGS), outcomes.expansions(gains, merit.failures > 0)
    for _ in range(PASSES):
        if not (expansions and dampings):
            break
        bound = [with_bound_end(expansion, evaluation, plan, end_share) for expansion in expansions]
        improved = shared_gains(bound, gains, deviations, np.diag(dampings[0] * unit), problem.scales.x)
        trials = (_between(gains, improved, length) for length in STEP_LENGTHS)
        better = next(((trial, new) for trial in trials if (new := outcomes.merit(trial)) < merit), None)
        if better is None:
            dampings.pop(0)
            continue
        previous, (gains, merit) = merit, better
        if merit[:3] == previous[:3] and previous.cost - merit.cost < LEAST_DECREASE * abs(merit.cost):
            break
        if previous.failures > merit.failures == 0:
            dampings = list(DAMPINGS)
        expansions = outcomes.expansions(gains, merit.failures > 0)
    return gains, merit


def _between(gains: Gains, improved: Gains, share: float) -> Gains:
    return Gains(gains.K + share * (improved.K - gains.K), gains.k + share * (improved.k - gains.k))
