"""P2: the Heaviside function, whose pathwise gradient says nothing."""

from __future__ import annotations

import numpy as np
import xarray as xr
from scipy.stats import norm

from dynamics.batch import Gaussian
from ocp.gradients import estimate_gradient
from ocp.gradients.estimators import mean_cost
from problems.objectives import objective_spec
from problems.studies.study import CODE, StudyParams, quantity_of, setting

ESTIMATORS = ("zobg", "zobg-zero-noise", "zobg-mean", "fobg")
_BOXES = (0.1, 0.01, 0.001)
"""Widths, over sigma, of the boxes of area one that narrow to the delta."""


class Params(StudyParams):
    """Parameters of P2, from the authors' public code: the paper's text has none."""

    sigma: float = setting(0.2, "1", "standard deviation of the noise", CODE, above=0)
    reach: float = setting(1.5, "1", "largest |theta| drawn", CODE, above=0)
    points: int = setting(50, "1", "values of theta", CODE, least=10)
    n_samples: int = setting(10_000, "1", "samples at each theta", CODE, least=2)


def run(params: Params) -> xr.Dataset:
    """Objective, estimates and variances over theta, beside their closed forms."""
    thetas = np.linspace(-params.reach, params.reach, params.points)
    shape = (len(ESTIMATORS), len(thetas))
    mean, variance, error = np.empty(shape), np.empty(shape), np.empty(shape)
    sampled, forms = np.empty(len(thetas)), []
    base = objective_spec("heaviside").objective()
    for i, theta in enumerate(thetas):
        objective = base.at({"theta": theta})
        seed = np.random.SeedSequence(params.seed, spawn_key=(i,))
        found = estimate_gradient(
            objective, ESTIMATORS, params.n_samples, params.sigma, seed, reference="none"
        )
        for j, estimate in enumerate(found.values()):
            mean[j, i], variance[j, i] = estimate.mean[0], estimate.variance[0]
            error[j, i] = estimate.standard_error[0]
        sampled[i] = mean_cost(objective, Gaussian(params.sigma, seed), params.n_samples)
        forms.append(objective.closed_form(params.sigma))
    boxes = params.sigma * np.array(_BOXES)
    edges = boxes[:, None] / 2
    # Half of the box on each side of w = -theta; differences of the nearer tail do not cancel.
    delta = (norm.sf(np.abs(thetas) - edges, 0, params.sigma)
             - norm.sf(np.abs(thetas) + edges, 0, params.sigma)) / (2 * edges)  # fmt: skip
    both = ("estimator", "theta")
    return xr.Dataset(
        {
            "f": quantity_of("theta", (thetas >= 0) * 1.0, "1", "objective without noise"),
            "F": quantity_of("theta", [c.objective for c in forms], "1", "smoothed, closed form"),
            "F_sampled": quantity_of("theta", sampled, "1", "smoothed, mean of samples"),
            "gradient": quantity_of("theta", [c.gradient[0] for c in forms], "1", "of F"),
            "fobg_mean": quantity_of("theta", [c.fobg_mean[0] for c in forms], "1",
                                     "expectation of a first-order sample"),
            "delta": quantity_of(("box", "theta"), delta, "1",
                                 "expectation of a box of area one around 0, at theta + w"),
            "zobg_variance": quantity_of("theta", [c.zobg_variance[0] for c in forms], "1",
                                         "of one ZoBG sample without baseline, closed form"),
            "mean": quantity_of(both, mean, "1", "estimated gradient"),
            "variance": quantity_of(both, variance, "1", "empirical variance of one sample"),
            "standard_error": quantity_of(both, error, "1", "standard error of the mean"),
        },
        {
            "theta": quantity_of("theta", thetas, "1", "decision"),
            "box": quantity_of("box", boxes, "1", "width of the box"),
            "estimator": list(ESTIMATORS),
        },
    )  # fmt: skip
