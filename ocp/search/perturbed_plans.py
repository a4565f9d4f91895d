"""Sampled plans near an answer: its inputs are changed at random, and each changed plan is improved separately.

An answer is a local optimum, so that small changes raise its cost; a larger change may lie in the basin of a cheaper
optimum with another contact schedule. Many changed plans are improved side by side, each by short runs of the
cross-entropy method with its own mean and deviation, and the best of them are solved on their branches (iterated local
search, as in basin hopping).
"""

from __future__ import annotations

from itertools import product

import numpy as np

from ocp.search.sampling import KNOTS, InputSampler
from ocp.search.sampling_runs import SampledPlan, input_basis

MAX_PLANS = 48
"""Maximum number of changed plans."""
MIN_PLANS = 8
"""Minimum number of changed plans, whatever a step costs."""
SAMPLES = 48
"""Number of samples of a changed plan in a round."""
ROUNDS = 16
"""Number of rounds in which a changed plan is improved."""
SMOOTHING = 0.2
"""Weight of the previous mean and deviation in the new ones."""
ELITES = 6
"""Number of samples of a round that the next distribution is fitted to."""
SHARES = (10**-2.2, 10**-0.2)
"""Smallest and largest standard deviation of a change, as shares of half the range between bounds."""
NARROWER = 0.5
"""Initial deviation of the samples around a changed plan, as a share of that of the change."""


def perturbed_plans(sampler: InputSampler, inputs: np.ndarray, generator: np.random.Generator) -> list[SampledPlan]:
    """Return plans near inputs (N, nu), cheapest first; each is improved under the exact law from a random change.

    Sizes of changes are drawn log-uniformly from :data:`SHARES`; changes are piecewise linear or constant between the
    knots of :func:`~ocp.search.sampling_runs.input_basis`. The number of plans follows from the
    sampler's ``step_budget``.
    """
    N = len(inputs)
    bases = [input_basis(basis, N, min(knots, N)) for basis, knots in product(("linear", "constant"), KNOTS[:2])]
    bases.append(input_basis("linear", N, min(KNOTS[-1], N)))
    count = int(np.clip(sampler.step_budget / (N * SAMPLES * ROUNDS), MIN_PLANS, MAX_PLANS))
    plans = list[SampledPlan]()
    for index, weights in enumerate(bases):
        size = len(range(index, count, len(bases)))
        plans += _improved(sampler, inputs, weights, size, generator)
    return sorted(plans, key=lambda plan: plan.cost)


def _improved(
    sampler: InputSampler, inputs: np.ndarray, weights: np.ndarray, count: int, generator: np.random.Generator
) -> list[SampledPlan]:
    """Return ``count`` plans, each improved from inputs (N, nu) plus a random change in a basis ``weights`` (N, K)."""
    shape = (count, weights.shape[1], inputs.shape[1])
    low, high = np.log(SHARES)
    deviation = np.exp(generator.uniform(low, high, (count, 1, 1))) * sampler.reach
    mean = deviation * generator.standard_normal(shape)
    deviation = np.broadcast_to(NARROWER * deviation, shape)
    best, best_cost = mean, np.full(count, np.inf)
    for _ in range(ROUNDS):
        z = mean[:, None] + deviation[:, None] * generator.standard_normal((count, SAMPLES, *shape[1:]))
        z[:, 0], z[:, 1] = best, mean
        costs = sampler.exact_costs(inputs + weights @ z.reshape(-1, *shape[1:])).reshape(count, SAMPLES)
        order = np.argsort(costs, axis=1, kind="stable")[:, :ELITES]
        elites = np.take_along_axis(z, order[:, :, None, None], axis=1)
        least = np.take_along_axis(costs, order[:, :1], axis=1)[:, 0]
        is_better = least < best_cost
        best = np.where(is_better[:, None, None], elites[:, 0], best)
        best_cost = np.fmin(best_cost, least)
        mean = SMOOTHING * mean + (1 - SMOOTHING) * elites.mean(axis=1)
        deviation = SMOOTHING * deviation + (1 - SMOOTHING) * elites.std(axis=1)
    clipped = np.clip(inputs + weights @ best, sampler.lower, sampler.upper)
    name = f"exact law, {weights.shape[1]} pieces changed"
    return [SampledPlan(plan, float(cost), name) for plan, cost in zip(clipped, best_cost, strict=True)]
