"""P2: the Heaviside function, whose pathwise gradient is zero almost everywhere."""

from __future__ import annotations

import numpy as np
import xarray as xr
from scipy.stats import norm

from dynamics.batch import Gaussian
from ocp.gradients import estimate_gradient
from ocp.gradients.estimators import mean_cost
from problems.registry import objective_spec
from problems.studies.study import CODE, Claim, StudyParams, claim, dataset, largest_value, setting

NOTES = (
    "erf(y; s²) in the paper is the upper tail of the Gaussian, not the usual error function.",
    "The mean of the first order's samples does converge, to 0: what fails in ex. III.2 is to"
    " exchange gradient and expectation.",
    "Zero-noise baseline as in the paper's definition, and the mean of the other samples.",
)

ESTIMATORS = ("zobg", "zobg-zero-noise", "zobg-mean", "fobg")
"""Names of the estimators that are compared."""
_BOX_WIDTHS = (0.1, 0.01, 0.001)
"""Widths, relative to sigma, of boxes of area one that approximate the Dirac delta."""


class Params(StudyParams):
    """Parameters of study P2, from the authors' public code, since the paper gives no numbers."""

    sigma: float = setting(0.2, "1", "standard deviation of the noise", CODE, above=0)
    reach: float = setting(1.5, "1", "largest |theta| drawn", CODE, above=0)
    points: int = setting(50, "1", "values of theta", CODE, least=10)
    n_samples: int = setting(10_000, "1", "samples at each theta", CODE, least=2)


def run(params: Params) -> xr.Dataset:
    """Compute the objective, gradient estimates and their variances over theta, with their closed forms."""
    thetas = np.linspace(-params.reach, params.reach, params.points)
    shape = (len(ESTIMATORS), len(thetas))
    mean, variance, error = np.empty(shape), np.empty(shape), np.empty(shape)
    sampled, forms = np.empty(len(thetas)), []
    base = objective_spec("heaviside").objective()
    for i, theta in enumerate(thetas):
        objective = base.at({"theta": theta})
        seed = np.random.SeedSequence(params.seed, spawn_key=(i,))
        estimates = estimate_gradient(objective, ESTIMATORS, params.n_samples, params.sigma, seed, reference="none")
        for j, estimate in enumerate(estimates.values()):
            mean[j, i], variance[j, i] = estimate.mean[0], estimate.variance[0]
            error[j, i] = estimate.standard_error[0]
        sampled[i] = mean_cost(objective, Gaussian(params.sigma, seed), params.n_samples)
        forms.append(objective.closed_form(params.sigma))
    boxes = params.sigma * np.array(_BOX_WIDTHS)
    edges = boxes[:, None] / 2
    # The box is centred at w = -theta; a difference of upper tails, at |theta|, suffers no cancellation.
    delta = (norm.sf(np.abs(thetas) - edges, 0, params.sigma) - norm.sf(np.abs(thetas) + edges, 0, params.sigma)) / (
        2 * edges
    )
    dimensions = ("estimator", "theta")
    return dataset(
        {
            "f": ("theta", (thetas >= 0) * 1.0, "1", "objective without noise"),
            "F": ("theta", [c.objective for c in forms], "1", "smoothed, closed form"),
            "F_sampled": ("theta", sampled, "1", "smoothed, mean of samples"),
            "gradient": ("theta", [c.gradient[0] for c in forms], "1", "of F"),
            "fobg_mean": ("theta", [c.fobg_mean[0] for c in forms], "1", "expectation of a first-order sample"),
            "delta": (("box", "theta"), delta, "1", "expectation of a box of area one around 0, at theta + w"),
            "zobg_variance": (
                "theta",
                [c.zobg_variance[0] for c in forms],
                "1",
                "of one ZoBG sample without baseline, closed form",
            ),
            "mean": (dimensions, mean, "1", "estimated gradient"),
            "variance": (dimensions, variance, "1", "empirical variance of one sample"),
            "standard_error": (dimensions, error, "1", "standard error of the mean"),
        },
        {"theta": (thetas, "1", "decision"), "box": (boxes, "1", "width of the box"), "estimator": list(ESTIMATORS)},
    )


_SAMPLES_PER_SIDE = 30
"""Expected number of samples on each side of the jump for which errors are nearly normally distributed."""


def claims(data: xr.Dataset) -> list[Claim]:
    """Return the claims of Suh et al. 2022, ex. III.2 and fig. 2."""
    return [*_objective(data), *_first_order(data)]


def _objective(data: xr.Dataset) -> list[Claim]:
    """Check the smoothed objective and the zeroth-order gradient where samples fall on both sides of the jump."""
    n, F = data.attrs["n_samples"], data["F"].values
    has_both_sides = n * F * (1 - F) >= _SAMPLES_PER_SIDE
    zeroth = data.sel(estimator="zobg")
    score = (zeroth["mean"].values - data["gradient"].values)[has_both_sides]
    gradient_score = largest_value(np.abs(score) / np.sqrt(data["zobg_variance"].values[has_both_sides] / n))
    spread = np.sqrt(F * (1 - F) / n)[has_both_sides]
    objective_score = largest_value(np.abs(data["F_sampled"].values - F)[has_both_sides] / spread)
    ratio = zeroth["variance"].values[has_both_sides] / data["zobg_variance"].values[has_both_sides]
    # Relative error of a variance whose samples have the kurtosis of w times 0 or 1.
    blur = 5 * np.sqrt(6 / (n * np.minimum(F, 1 - F)[has_both_sides]))
    theta_count = (
        f" at {has_both_sides.sum()} of {has_both_sides.size} theta, those with {_SAMPLES_PER_SIDE} samples a side"
    )
    return [
        claim("The stochastic objective is the error function", "Pathologies, ex. III.2")
        .expected("F = erf(-theta; sigma²), read as the Gaussian tail")
        .measured(f"off by {objective_score:.2g} standard errors at most" + theta_count)
        .below(objective_score, 5),
        claim("The zeroth-order estimate is unbiased", "Pathologies, sec. III-A, ex. III.2")
        .expected("F' = phi(theta/sigma)/sigma")
        .measured(f"off by {gradient_score:.2g} standard errors at most" + theta_count)
        .below(gradient_score, 5),
        claim("The variance of the zeroth order is that of its closed form", "our check")
        .expected("ratio 1")
        .measured(f"off by {largest_value(np.abs(ratio - 1)):.3f} at most" + theta_count)
        .holds(has_both_sides.any(), np.abs(ratio - 1) < blur),
    ]


def _first_order(data: xr.Dataset) -> list[Claim]:
    """Check mean, variance and expectation of the first-order gradient."""
    true, first = data["gradient"].values, data.sel(estimator="fobg")
    mean, limit = first["mean"].values, data["fobg_mean"].values
    errors = np.abs(mean - limit)
    diverges = errors > 5 * first["standard_error"].values
    delta, narrow = data["delta"].values[-1], float(data["box"][-1])
    equal = float(np.abs(delta - true).max() / true.max())
    return [
        claim("The first-order estimate is zero, so it is biased at any theta", "Pathologies, ex. III.2")
        .expected("0, while F' > 0")
        .measured(f"at most {np.abs(mean).max():g}; F' from {true.min():.1e} to {true.max():.4g}")
        .holds(mean == 0, true > 0),
        claim("The empirical variance of the first order is zero", "Pathologies, ex. III.2, fig. 2")
        .expected("0")
        .measured(f"{float(first['variance'].max()):g}")
        .equals(first["variance"], 0),
        claim("The law of large numbers does not hold for the first order", "Pathologies, ex. III.2")
        .expected("the mean of the samples stays off their expectation")
        .measured(
            f"off by {errors.max():g} at most, at {np.sum(diverges)} of {diverges.size} theta;"
            f" their expectation is {np.abs(limit).max():g}, F' up to {true.max():.4g}"
        )
        .holds(diverges.any()),
        claim("E delta(theta + w) = 0", "Pathologies, ex. III.2")
        .expected("0, the limit of narrow boxes")
        .measured(
            f"up to {delta.max():.4g} in a box of width {narrow:g}, equal to F' within {equal:.1e} of its largest"
        )
        .below(delta, 0.001 * true.max()),
    ]
