"""What P7's data say of sec. IV-C."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.interpolated_gradients.data import CASES, ESTIMATORS
from problems.studies.study import Claim, share_margin

_PLACE = "Pathologies, "


def _worst(data: xr.Dataset, case: str, estimator: str) -> float:
    """Largest root-mean-square error over decisions, as a share of the largest gradient."""
    one = data.sel(case=case)
    off = one["mean"].sel(estimator=estimator) - one["truth"]
    size = float(np.abs(one["truth"]).max())
    return float(np.sqrt((off**2).mean("run")).max()) / size


def claims(data: xr.Dataset) -> list[Claim]:
    """What sec. IV-C says."""
    gamma, delta = data.attrs["gamma"], data.attrs["delta"]
    steps = data.sel(case="heaviside")
    zeros = steps["alpha"].sel(estimator="alpha-variance") == 1
    fooled = float(zeros.mean())
    off = np.abs(data["mean"].sel(estimator="alpha") - data["truth"])
    within = off <= data["gamma_of_case"]
    kept = float(within.mean())
    blind = data.sel(case="coulomb", estimator="alpha-variance")
    blind_share = float((blind["alpha"] == 1).mean())
    worst = {(c, e): _worst(data, c, e) for c in CASES for e in ESTIMATORS}
    fixed = [worst[c, "alpha-fixed"] for c in CASES]
    wall = data.sel(case="ball-wall")
    spread = wall["mean"].std("run")
    far = int(np.abs(wall["theta"].values - wall["theta"].values.min()).argmin())
    gain = float(spread.sel(estimator="alpha")[far] / spread.sel(estimator="zobg-mean")[far])
    return [
        Claim("Empirical variance is an unreliable guide where the first order is biased",
              _PLACE + "sec. IV-C", "inverse variance takes the Heaviside's zeros alone, alpha = 1",
              f"in {fooled:.0%} of runs, error {worst['heaviside', 'alpha-variance']:.3f}"
              " of the largest gradient", fooled > 0.99, share_margin(zeros, 0.99)),
        Claim("The same happens under empirical bias", "our check",
              "alpha = 1 where no sample falls within nu",
              f"in {blind_share:.0%} of runs, error"
              f" {worst['coulomb', 'alpha-variance']:.3f}", blind_share > 0.1,
              share_margin(blind["alpha"] == 1, 0.1)),
        Claim("A confidence interval from the zeroth order mends it", _PLACE + "sec. IV-C",
              f"error <= gamma = {gamma:g} of the largest gradient, with probability"
              f" {1 - delta:g}", f"in {kept:.2%} of all runs", kept >= 1 - delta,
              share_margin(within, 1 - delta)),
        Claim("A constant weight carries its share of the bias", "our check",
              f"about {data.attrs['alpha']:g} where the first order is zero",
              f"{fixed[0]:.3f} on the Heaviside", bool(abs(fixed[0] - data.attrs["alpha"]) < 0.1)),
        Claim("Where the first order is right, the interpolation is the more accurate for it",
              "our check", "spread below the zeroth order's",
              f"{gain:.2g} of it at theta = {float(wall['theta'][far]):g} rad, far from the corner",
              gain < 0.5),
    ]  # fmt: skip
