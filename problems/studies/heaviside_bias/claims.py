"""What P2's data say of ex. III.2 and fig. 2."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.study import Claim, largest

_PLACE = "Pathologies, "
_BOTH_SIDES = 30
"""Samples expected on each side of the jump from which errors are near normal."""


def claims(data: xr.Dataset) -> list[Claim]:
    """What ex. III.2 and fig. 2 say."""
    return [*_objective(data), *_first_order(data)]


def _objective(data: xr.Dataset) -> list[Claim]:
    """The smoothed objective and the zeroth order, where samples fall on both sides of the jump."""
    n, F = data.attrs["n_samples"], data["F"].values
    told = n * F * (1 - F) >= _BOTH_SIDES
    zeroth = data.sel(estimator="zobg")
    score = (zeroth["mean"].values - data["gradient"].values)[told]
    off = largest(np.abs(score) / np.sqrt(data["zobg_variance"].values[told] / n))
    spread = np.sqrt(F * (1 - F) / n)[told]
    objective = largest(np.abs(data["F_sampled"].values - F)[told] / spread)
    ratio = zeroth["variance"].values[told] / data["zobg_variance"].values[told]
    # The relative error of a variance whose samples have the kurtosis of a product w · {0, 1}.
    blur = 5 * np.sqrt(6 / (n * np.minimum(F, 1 - F)[told]))
    where = f" at {told.sum()} of {told.size} theta, those with {_BOTH_SIDES} samples a side"
    return [
        Claim("The stochastic objective is the error function", _PLACE + "ex. III.2",
              "F = erf(-theta; sigma²), read as the Gaussian tail", f"off by {objective:.2g}"
              " standard errors at most" + where, objective < 5),
        Claim("The zeroth-order estimate is unbiased", _PLACE + "sec. III-A, ex. III.2",
              "F' = phi(theta/sigma)/sigma", f"off by {off:.2g} standard errors at most" + where,
              off < 5),
        Claim("The variance of the zeroth order is that of its closed form", "our check",
              "ratio 1", f"off by {largest(np.abs(ratio - 1)):.3f} at most" + where,
              bool(told.any() and np.all(np.abs(ratio - 1) < blur))),
    ]  # fmt: skip


def _first_order(data: xr.Dataset) -> list[Claim]:
    """What of the first order is zero, and what is not."""
    true, first = data["gradient"].values, data.sel(estimator="fobg")
    mean, limit = first["mean"].values, data["fobg_mean"].values
    apart = np.abs(mean - limit)
    diverges = apart > 5 * first["standard_error"].values
    delta, narrow = data["delta"].values[-1], float(data["box"][-1])
    equal = float(np.abs(delta - true).max() / true.max())
    return [
        Claim("The first-order estimate is zero, so it is biased at any theta",
              _PLACE + "ex. III.2", "0, while F' > 0",
              f"at most {np.abs(mean).max():g}; F' from {true.min():.1e} to {true.max():.4g}",
              bool(np.all(mean == 0) and np.all(true > 0))),
        Claim("The empirical variance of the first order is zero", _PLACE + "ex. III.2, fig. 2",
              "0", f"{float(first['variance'].max()):g}", bool(np.all(first["variance"] == 0))),
        Claim("The law of large numbers does not hold for the first order",
              _PLACE + "ex. III.2", "the mean of the samples stays off their expectation",
              f"off by {apart.max():g} at most, at {np.sum(diverges)} of {diverges.size} theta;"
              f" their expectation is {np.abs(limit).max():g}, F' up to {true.max():.4g}",
              bool(diverges.any())),
        Claim("E delta(theta + w) = 0", _PLACE + "ex. III.2", "0, the limit of narrow boxes",
              f"up to {delta.max():.4g} in a box of width {narrow:g}, equal to F' within"
              f" {equal:.1e} of its largest", bool(delta.max() < 1e-3 * true.max())),
    ]  # fmt: skip
