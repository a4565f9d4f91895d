"""What A5's data say of fig. 5."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.shared.compared_runs import area, difference, least
from problems.studies.study import Claim, over

_PLACE = "ABS, sec. 7.4"
_SHARP, _WIDE = "mu 1e-10", "mu 0.01"
_ADAPTIVE = ("adaptive", "adaptive, gaussian")


def claims(data: xr.Dataset) -> list[Claim]:
    """Slow at 1e-10, lower at 1e-2, adaptive best, or not."""
    laws = [str(law) for law in data["law"].values]
    curves = {law: data["exact_return"].sel(law=law).values for law in laws}
    areas = {law: area(curve) for law, curve in curves.items()}
    ends = {law: curve.max(axis=1) for law, curve in curves.items()}
    fixed = [law for law in laws if law not in _ADAPTIVE]
    slower = difference(areas[_WIDE], areas[_SHARP])
    lower = difference(ends[_SHARP], ends[_WIDE])
    variance = {law: np.nanmedian(data["variance"].sel(law=law), axis=1) for law in laws}
    sharp = np.log10(variance[_SHARP])
    falling = [difference(sharp, np.log10(variance[law])) for law in laws[1:]]
    return [
        Claim("mu = 1e-10 learns slowly", _PLACE,
              "mean return over iterations below that of mu = 1e-2, 95 % over seeds",
              str(slower), slower.better, slower.margin),
        Claim("for its gradient has the higher variance", _PLACE,
              "decades of a run's median above every other law's, 95 % over seeds",
              f"{over(laws[1:], [each.better for each in falling])}:"
              f" {', '.join(map(str, falling))}", all(each.better for each in falling),
              least(falling)),
        Claim("mu = 1e-2 ends lower", _PLACE, "best return below that of mu = 1e-10, 95 %",
              str(lower), lower.better, lower.margin),
        *(claim for law in _ADAPTIVE for claim in _on_top(law, fixed, ends, areas)),
    ]  # fmt: skip


def _on_top(
    law: str, fixed: list[str], ends: dict[str, np.ndarray], areas: dict[str, np.ndarray]
) -> list[Claim]:
    """Whether an adaptive law is above every fixed mu."""
    place, name = (_PLACE, "The adaptive law") if law == _ADAPTIVE[0] else (
        "our check", "The law matched to Gaussian noise")  # fmt: skip
    found = []
    for words, expected, of in (
        ("ends the highest", "best return", ends),
        ("learns the fastest", "mean return over iterations", areas),
    ):
        gains = [difference(of[law], of[other]) for other in fixed]
        better = [gain.better for gain in gains]
        found.append(
            Claim(f"{name} {words}", place, f"{expected} above that of every fixed mu, 95 %",
                  f"{over(fixed, better)}: {', '.join(map(str, gains))}", all(better),
                  least(gains))
        )  # fmt: skip
    return found
