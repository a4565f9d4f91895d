"""An objective of one number, its smoothing and its estimated gradients, along that number."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from dynamics.batch import Gaussian
from ocp.gradients.estimators import SAMPLED
from ocp.gradients.objective import SampledObjective
from ocp.gradients.sampling import EstimatorRun, run_estimator

_NODES = 4001


@dataclass(frozen=True)
class DecisionSweep:
    """Everything over theta, (k,) each: f, its smoothing F and F' by quadrature, and estimates.

    ``first``, ``zeroth`` (k, 2) hold mean and standard error of FoBG and of ZoBG with the mean as
    baseline; ``first_variance``, ``zeroth_variance`` (k,) are of one sample.
    """

    f: np.ndarray
    F: np.ndarray
    slope: np.ndarray
    first: np.ndarray
    zeroth: np.ndarray
    first_variance: np.ndarray
    zeroth_variance: np.ndarray


def both_orders(
    objective: SampledObjective, sigma: float, n: int, seed: int, stream: int
) -> list[EstimatorRun]:
    """FoBG and ZoBG with the mean as baseline, on independent noise of a ``stream``."""
    seeds = np.random.SeedSequence(seed, spawn_key=(stream,)).spawn(2)
    return [
        run_estimator(objective, SAMPLED[name], Gaussian(sigma, own), n)
        for name, own in zip(("fobg", "zobg-mean"), seeds, strict=True)
    ]


def sweep_decision(
    objective: SampledObjective, theta: np.ndarray, sigma: float, n: int, seed: int
) -> DecisionSweep:
    """Evaluate ``objective``, whose noise is added to its one decision, at ``theta`` (k,).

    F and F' by quadrature over +-6 sigma: ``F' = E[f w]/sigma²``, which needs no derivative.
    """
    w = np.linspace(-6, 6, _NODES) * sigma
    weight = norm.pdf(w, 0, sigma)
    weight /= weight.sum()
    rows = []
    for index, at in enumerate(theta):
        here = objective.at({objective.decision[0].name: float(at)})
        cost = here.costs(w[:, None])
        middle = here.nominal()
        # Independent streams for every point, so that errors show as scatter, not as an offset.
        found = [sampled.moments for sampled in both_orders(here, sigma, n, seed, index)]
        rows.append([
            middle, weight @ cost, weight @ ((cost - middle) * w) / sigma**2,
            *(float(value) for m in found for value in (m.mean[0], m.standard_error[0],
                                                        m.variance[0])),
        ])  # fmt: skip
    f, F, slope, *estimates = np.transpose(rows)
    first, first_error, first_variance, zeroth, zeroth_error, zeroth_variance = estimates
    return DecisionSweep(
        f, F, slope, np.stack((first, first_error), 1), np.stack((zeroth, zeroth_error), 1),
        first_variance, zeroth_variance,
    )  # fmt: skip
