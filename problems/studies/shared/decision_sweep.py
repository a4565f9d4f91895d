"""Sweeps of one decision: an objective, its smoothing and its estimated gradients."""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from dynamics.batch import Gaussian
from ocp.gradients.estimators import SAMPLED
from ocp.gradients.objective import SampledObjective
from ocp.gradients.sampling import EstimatorRun, run_estimator

_QUADRATURE_NODES = 4001
"""Number of nodes of the quadrature over the noise."""


def both_orders(objective: SampledObjective, sigma: float, n: int, seed: int, stream: int) -> list[EstimatorRun]:
    """Run the first-order estimator, and the zeroth-order estimator with mean baseline, on independent noise."""
    seeds = np.random.SeedSequence(seed, spawn_key=(stream,)).spawn(2)
    return [
        run_estimator(objective, SAMPLED[name], Gaussian(sigma, own_seed), n)
        for name, own_seed in zip(("fobg", "zobg-mean"), seeds, strict=True)
    ]


def sweep_decision(
    objective: SampledObjective, theta: np.ndarray, sigma: float, n: int, seed: int
) -> dict[str, np.ndarray]:
    """Return the smoothed objective and gradient estimates at decisions ``theta`` (k,) with added noise.

    ``F`` and ``slope`` (k,) are the smoothed objective and its derivative by quadrature over +-6
    sigma, ``F' = E[f w]/sigma²``; ``first`` and ``zeroth`` (k, 2) are mean and standard error
    of the estimators of :func:`both_orders`, ``first_variance`` and ``zeroth_variance`` (k,) the variances
    of one sample.
    """
    w = np.linspace(-6, 6, _QUADRATURE_NODES) * sigma
    weight = norm.pdf(w, 0, sigma)
    weight /= weight.sum()
    rows = []
    for index, decision in enumerate(theta):
        at_decision = objective.at({objective.decision[0].name: float(decision)})
        cost = at_decision.costs(w[:, None])
        middle = at_decision.nominal_cost()
        # Every point has its own random stream, so that errors appear as scatter, not as an offset.
        estimates = [sampled.moments for sampled in both_orders(at_decision, sigma, n, seed, index)]
        rows.append(
            [
                weight @ cost,
                weight @ ((cost - middle) * w) / sigma**2,
                *(float(value) for m in estimates for value in (m.mean[0], m.standard_error[0], m.variance[0])),
            ]
        )
    estimates = np.array(rows)
    return {
        "F": estimates[:, 0],
        "slope": estimates[:, 1],
        "first": estimates[:, 2:4],
        "zeroth": estimates[:, 5:7],
        "first_variance": estimates[:, 4],
        "zeroth_variance": estimates[:, 7],
    }
