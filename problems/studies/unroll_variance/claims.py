"""What A3's data say of fig. 3 and of theorem 4.4."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from problems.studies.study import Claim, over
from problems.studies.unroll_variance.data import LAWS, TASKS

_PLACE = "ABS, sec. 7.2"
_SHARP, _WIDE, _ADAPTIVE = "mu 1e-10", "mu 0.01", "adaptive"
_LONG = 5
"""Lengths from here on tell how the variance grows: shorter ones may meet no contact."""


@dataclass(frozen=True)
class Growth:
    """Slope of log variance over the unroll length, and its interval over the policies."""

    rate: float
    low: float
    high: float

    @property
    def error(self) -> float:
        """Standard error of the rate."""
        return (self.high - self.low) / 4

    def above(self, other: Growth) -> float:
        """How far the rate lies above another, in standard errors of the difference."""
        return (self.rate - other.rate) / np.hypot(self.error, other.error)

    def __str__(self) -> str:
        return f"{self.rate:.2f} ({self.low:.2f} to {self.high:.2f})"


def growth(data: xr.Dataset, task: str, law: str) -> Growth:
    """Mean over stages of the fitted slope, with twice its standard error."""
    one = data["variance"].sel(task=task, law=law)
    lengths = one["length"].values
    chosen = lengths >= _LONG
    slopes = []
    for row in one.transpose("stage", "length").values:
        good = chosen & (row > 0)
        if good.sum() > 2:
            slopes.append(np.polyfit(lengths[good], np.log(row[good]), 1)[0])
    if len(slopes) < 2:
        return Growth(np.nan, np.nan, np.nan)
    mean, error = float(np.mean(slopes)), float(np.std(slopes, ddof=1) / np.sqrt(len(slopes)))
    return Growth(mean, mean - 2 * error, mean + 2 * error)


def bound_rate(data: xr.Dataset, task: str, law: str) -> float:
    """Growth of theorem 4.4's bound a step at most: ``4 log(sqrt 2 L_f L_pi)``, both at least 1."""
    slope = data["lipschitz"].sel(task=task, law=law).max("stage")
    policy = data["lipschitz_policy"].sel(task=task).max("stage")
    return float(4 * np.log(np.sqrt(2) * np.maximum(slope, 1) * np.maximum(policy, 1)))


def claims(data: xr.Dataset) -> list[Claim]:
    """What the text says of the figure, and how the theorem compares."""
    rates = {(t, law): growth(data, t, law) for t in TASKS for law in LAWS}
    mean = data["variance"].mean("stage")
    last = mean.isel(length=-1)
    shares = {
        t: [float(last.sel(task=t, law=law) / last.sel(task=t, law=_SHARP)) for law in LAWS]
        for t in TASKS
    }
    wide, adaptive = list(LAWS).index(_WIDE), list(LAWS).index(_ADAPTIVE)
    exploding = [rates[t, _SHARP].low > 0 for t in TASKS]
    flatter = [rates[t, _WIDE].high < rates[t, _SHARP].low for t in TASKS]
    apart = [rates[t, _SHARP].above(rates[t, _WIDE]) for t in TASKS]
    ordered = [bool(np.all(np.diff(shares[t][:5]) >= 0)) for t in TASKS]
    below = [rates[t, law].low <= bound_rate(data, t, law) for t in TASKS for law in LAWS]
    loose = [bound_rate(data, t, _SHARP) / rates[t, _SHARP].rate for t in TASKS]
    constants = data["lipschitz"].max("stage")
    falling = [float(constants.sel(task=t, law=_WIDE)) < float(constants.sel(task=t, law=_SHARP))
               for t in TASKS]  # fmt: skip
    return [
        Claim("The variance explodes with the unroll length at mu = 1e-10", _PLACE,
              f"log variance grows from H = {_LONG} on, 95 % over policies",
              f"{over(TASKS, exploding)}: {', '.join(str(rates[t, _SHARP]) for t in TASKS)} a step",
              all(exploding), min(r.rate / r.error for r in (rates[t, _SHARP] for t in TASKS))),
        Claim("As mu increases the variance decreases", _PLACE,
              "at the longest unroll, over mu = 1e-2 down to 1e-10 never falling",
              f"{over(TASKS, ordered)}: "
              + "; ".join(", ".join(f"{s:.2g}" for s in shares[t][:5]) for t in TASKS)
              + f" of that at {_SHARP}", all(ordered)),
        Claim("At mu = 1e-2 it grows more slowly than at 1e-10", _PLACE,
              "intervals of the growth apart",
              f"{over(TASKS, flatter)}: {', '.join(str(rates[t, _WIDE]) for t in TASKS)} a step",
              all(flatter), min(apart)),
        Claim("The adaptive law's variance lies between", "our check",
              "at the longest unroll between those of mu = 1e-2 and 1e-10",
              "; ".join(f"{t} {shares[t][adaptive]:.2g} of that at {_SHARP}, {_WIDE} has"
                        f" {shares[t][wide]:.2g}" for t in TASKS),
              all(min(shares[t][wide], 1) <= shares[t][adaptive] <= max(shares[t][wide], 1)
                  for t in TASKS)),
        Claim("The growth stays below theorem 4.4's", "ABS, thm. 4.4, constant mended",
              "4 log(sqrt 2 L_f L_pi) a step",
              f"bounds {', '.join(f'{bound_rate(data, t, _SHARP):.3g}' for t in TASKS)} at"
              f" {_SHARP}, {', '.join(f'{r:.2g}' for r in loose)} times the growth", all(below)),
        Claim("A larger mu means a larger Lipschitz constant", "ABS, sec. 7.2, as printed",
              "L_f at mu = 1e-2 above that at 1e-10",
              ", ".join(f"{t} {float(constants.sel(task=t, law=_WIDE)):.3g} and"
                        f" {float(constants.sel(task=t, law=_SHARP)):.3g}" for t in TASKS),
              not any(falling)),
    ]  # fmt: skip
