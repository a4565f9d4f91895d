"""What A2v's data say of sec. 4.3 and 7.2."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.study import Claim, over

_STIFF = 1e-3
"""mu up to which the landing is stiff: the variance has left the soft regime."""


def claims(data: xr.Dataset) -> list[Claim]:
    """What sec. 4.3 and 7.2 say."""
    mu, h = data["mu"].values, data["h"].values
    first, ratio = data["first_order"].values, data["likelihood_ratio"].values
    soft = int(np.abs(np.log(mu / 1e-1)).argmin())
    large = first[:, 0] > 10 * first[:, soft]
    stiff = mu <= _STIFF * (1 + 1e-9)
    flat = first[:, 0] / first[:, 1]
    share = ratio[:, stiff] / first[:, stiff]
    low = np.all(share < 0.1, axis=1)
    spread = ratio[:, stiff].max(axis=1) / ratio[:, stiff].min(axis=1)
    slope = float(np.polyfit(np.log(h), np.log(first[:, 0]), 1)[0])
    steps = list(h)
    return [
        Claim("Stiff systems with small mu lead to large first-order variance", "ABS, sec. 7.2",
              f"at mu = {mu[0]:g} ten times that at {mu[soft]:g}", f"h {over(steps, large)} s:"
              f" {(first[:, 0] / first[:, soft]).min():.2g} times or more", bool(np.all(large))),
        Claim("That variance grows without bound as mu falls", "ABS, sec. 4.3",
              "with a tenth of mu twice the variance or more",
              f"{flat.min():.3f} to {flat.max():.3f} times from mu = {mu[1]:g} to {mu[0]:g}",
              bool(np.all(flat > 2))),
        Claim("What bounds it is the step: the slope through an impact is 1/h",
              "our check", "variance ~ 1/h at small mu", f"h to the power {slope:.2f}",
              bool(-1.4 < slope < -0.6)),
        Claim("LR gradients have low variance in the presence of stiffness", "ABS, sec. 7.2",
              f"a tenth of first order or less for mu <= {_STIFF:g}",
              f"h {over(steps, low)} s: {share.min():.2f} to {share.max():.2f} of first order",
              bool(np.all(low))),
        Claim("LR variance stays what it is as mu falls", "our check",
              f"flat for mu <= {_STIFF:g}", f"within a factor {spread.max():.3g}, as first order"
              f" within {(first[:, stiff].max(axis=1) / first[:, stiff].min(axis=1)).max():.3g}",
              bool(np.all(spread < 3))),
    ]  # fmt: skip
