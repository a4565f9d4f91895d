"""What P5's data say of ex. III.7, fig. 5 and sec. IV-A."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.stiff_pushing.data import MUS
from problems.studies.study import Claim, largest, listed, over

_LIGHT = 0.99
"""From here on the bodies keep their velocity over the spring's own time."""


def crossing(k: np.ndarray, first: np.ndarray, zeroth: np.ndarray) -> float:
    """Stiffness at which FoBG's variance passes ZoBG's, on log axes; NaN where it does not."""
    excess = np.log(first / zeroth)
    above = np.flatnonzero(excess > 0)
    if not above.size or above[0] == 0:
        return float("nan")
    right = int(above[0])
    part = excess[right - 1] / (excess[right - 1] - excess[right])
    return float(k[right - 1] * (k[right] / k[right - 1]) ** part)


def claims(data: xr.Dataset) -> list[Claim]:
    """What ex. III.7, fig. 5 and sec. IV-A say."""
    return [*_spring(data), *_implicit(data)]


def _spring(data: xr.Dataset) -> list[Claim]:
    """The penalty method over stiffness, for every factor on the velocity."""
    share, c = data["share"].values, data["damping"].values
    first, zeroth = data["damped"].values.transpose(2, 0, 1)
    light, factors = c >= _LIGHT, list(c)
    bound, seen = float(data["limit"]), float(data["unstable"])
    passes = data["damped_limit"].values * [
        crossing(share, one, other) for one, other in zip(first, zeroth, strict=True)
    ]
    crosses = np.isfinite(passes)
    below = first[:, 0] < 0.01 * zeroth[:, 0]
    flat = zeroth.max(axis=1) / zeroth.min(axis=1)
    growth = first.max(axis=1) / first[:, 0]
    grows = (growth > 1e3) & (flat < 2)
    return [
        Claim("ZoBG has lower variance than FoBG as stiffness increases",
              "Pathologies, ex. III.7", f"the curves cross below the limit, for c >= {_LIGHT:g}",
              f"c {over(factors, crosses)}: at k = " + listed(passes[crosses], ".3g") + " N/m",
              bool(np.all(crosses[light]))),
        Claim("At low stiffness it is the other way round", "our check", "FoBG far below ZoBG",
              f"c {over(factors, below)}: {largest(first[:, 0] / zeroth[:, 0]):.1e} of it at most"
              f" at {share[0]:g} of the limit", bool(np.all(below))),
        Claim("FoBG's variance grows with k, ZoBG's does not", "our check",
              f"1000 times and less than twice up to {share[-1]:g} of the limit, c >= {_LIGHT:g}",
              f"c {over(factors, grows)}: FoBG up " + listed(growth, ".1e")
              + " times, ZoBG within a factor " + listed(flat, ".2f"), bool(np.all(grows[light]))),
        Claim("Then semi-implicit integration becomes unstable", "Pathologies, ex. III.7",
              f"k = m (1 + c)/h² = {bound:.0f} N/m", f"spectral radius passes one at {seen:.0f}"
              " N/m", bool(abs(seen / bound - 1) < 2e-3)),
    ]  # fmt: skip


def _implicit(data: xr.Dataset) -> list[Claim]:
    first, zeroth = data["implicit_first"].values, data["implicit_zeroth"].values
    mus = listed(MUS, "g")
    return [
        Claim("Implicit time stepping avoids it, however rigid", "Pathologies, sec. IV-A",
              "FoBG far below ZoBG", f"FoBG {first[0]:.2g}, ZoBG {zeroth[0]:.2g} m⁴/N² (exact law)",
              bool(first[0] < 0.01 * zeroth[0])),
        Claim("Its smoothing keeps the variance low", "Pathologies, sec. IV-B",
              "FoBG far below ZoBG",
              listed(first[1:], ".2g") + " against "
              + listed(zeroth[1:], ".2g") + f" m⁴/N² at mu = {mus}",
              bool(np.all(first[1:] < 0.01 * zeroth[1:]))),
    ]  # fmt: skip
