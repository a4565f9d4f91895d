"""P2: the Heaviside function, whose pathwise gradient says nothing."""

from __future__ import annotations

import numpy as np
import xarray as xr

from dynamics.batch import Gaussian
from ocp.studies import estimate_gradient
from ocp.studies.estimators import mean_cost
from problems.objectives import objective_spec
from problems.spec import Citation
from problems.studies.study import CODE, Claim, Study, StudyParams, quantity_of, setting

ESTIMATORS = ("zobg", "zobg-zero-noise", "zobg-mean", "fobg")
_PLACE = "Pathologies, "


class Params(StudyParams):
    """Parameters of P2, from the authors' public code: the paper's text has none."""

    sigma: float = setting(0.2, "1", "standard deviation of the noise", CODE, above=0)
    reach: float = setting(1.5, "1", "largest |theta| drawn", CODE, above=0)
    points: int = setting(50, "1", "values of theta", CODE, least=2)
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
        forms.append(objective.reference(params.sigma))
    both = ("estimator", "theta")
    return xr.Dataset(
        {
            "f": quantity_of("theta", (thetas >= 0) * 1.0, "1", "objective without noise"),
            "F": quantity_of("theta", [c.objective for c in forms], "1", "smoothed, closed form"),
            "F_sampled": quantity_of("theta", sampled, "1", "smoothed, mean of samples"),
            "gradient": quantity_of("theta", [c.gradient[0] for c in forms], "1", "of F"),
            "zobg_variance": quantity_of("theta", [c.zobg_variance[0] for c in forms], "1",
                                         "of one ZoBG sample without baseline, closed form"),
            "mean": quantity_of(both, mean, "1", "estimated gradient"),
            "variance": quantity_of(both, variance, "1", "empirical variance of one sample"),
            "standard_error": quantity_of(both, error, "1", "standard error of the mean"),
        },
        {
            "theta": quantity_of("theta", thetas, "1", "decision"),
            "estimator": list(ESTIMATORS),
        },
    )  # fmt: skip


def claims(data: xr.Dataset) -> list[Claim]:
    """What ex. III.2 and fig. 2 say."""
    true, n = data["gradient"].values, data.attrs["n_samples"]
    zeroth, first = data.sel(estimator="zobg"), data.sel(estimator="fobg")
    error = np.maximum(np.sqrt(data["zobg_variance"].values / n), 1e-12)
    off = float((np.abs(zeroth["mean"].values - true) / error).max())
    F, p = data["F"].values, data["F_sampled"].values
    spread = np.sqrt(np.maximum(F * (1 - F), 1e-9) / n)
    objective = float((np.abs(p - F) / spread).max())
    busy = data["zobg_variance"].values > 0.1 * data["zobg_variance"].values.max()
    ratio = (zeroth["variance"].values / data["zobg_variance"].values)[busy]
    least = float(true.min())
    return [
        Claim("The stochastic objective is the error function", _PLACE + "ex. III.2",
              "F = erf(-theta; sigma²), read as the Gaussian tail", f"off by {objective:.2g}"
              " standard errors at most", objective < 5),
        Claim("The zeroth-order estimate is unbiased", _PLACE + "sec. III-A, ex. III.2",
              "F' = phi(theta/sigma)/sigma", f"off by {off:.2g} standard errors at most", off < 5),
        Claim("The first-order estimate is zero, so it is biased at any theta",
              _PLACE + "ex. III.2", "0, while F' > 0",
              f"0 everywhere; F' from {least:.1e} to {true.max():.4g}",
              bool(np.all(first["mean"].values == 0)) and least > 0),
        Claim("The empirical variance of the first order is zero", _PLACE + "ex. III.2, fig. 2",
              "0", f"{float(first['variance'].max()):g}", bool(np.all(first["variance"] == 0))),
        Claim("The variance of the zeroth order is that of its closed form", "our check",
              "ratio 1", f"{ratio.min():.3f} to {ratio.max():.3f} where it matters",
              bool(np.all(np.abs(ratio - 1) < 0.15))),
        Claim("The law of large numbers does not hold for the first order",
              _PLACE + "ex. III.2", "no convergence",
              "its samples are all 0 and so is their mean: what fails is to exchange gradient and"
              " expectation", False),
        Claim("E delta(theta + w) = 0", _PLACE + "ex. III.2", "0",
              f"{true.max():.4g} at theta nearest 0: it equals F'", False),
    ]  # fmt: skip


study = Study(
    id="P2",
    title="Gradient estimates of the Heaviside function",
    citation=Citation("suh2022pathologies", "Fig. 2, example III.2"),
    Params=Params,
    run=run,
    claims=claims,
    notes=(
        "erf(y; s²) in the paper is the upper tail of the Gaussian, not the usual error function.",
        "Zero-noise baseline as in the paper's definition, and the mean of the other samples.",
    ),
)
