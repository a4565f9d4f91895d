"""What A7's data say of fig. 7a and its text."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.shared.compared_runs import area, difference, least
from problems.studies.study import Claim, over
from problems.studies.thrown_ball.data import MUS

_PLACE = "ABS, sec. 7.3"
_REACHED = -0.01
_PROMINENT = 1e-3


def claims(data: xr.Dataset) -> list[Claim]:
    """What the text says of the ball, and what the landscapes show."""
    names = [str(name) for name in data["algorithm"].values]
    curves = {name: data["exact_return"].sel(algorithm=name).values for name in names}
    last = {name: curve[:, -1] for name, curve in curves.items()}
    areas = {name: area(curve) for name, curve in curves.items()}
    barriers = [f"BS {mu:g}" for mu in MUS]
    smoothed = [*barriers, "ABS quartic", "ABS gaussian"]
    found = []
    for other in ("ZOPG", "FOPG"):
        gains = [difference(last[name], last[other]) for name in barriers]
        faster = [difference(areas[name], areas[other]) for name in barriers]
        found += [
            Claim(f"Barrier smoothing ends at a higher return than {other}", _PLACE,
                  "final return above, 95 % over runs",
                  f"{over(MUS, [g.better for g in gains])}: {', '.join(map(str, gains))}",
                  all(g.better for g in gains), least(gains)),
            Claim(f"Barrier smoothing converges faster than {other}", _PLACE,
                  "mean return over iterations above, 95 % over runs",
                  f"{over(MUS, [g.better for g in faster])}: {', '.join(map(str, faster))}",
                  all(g.better for g in faster), least(faster)),
        ]  # fmt: skip
    best = max(barriers, key=lambda name: last[name].mean())
    for name in ("ABS quartic", "ABS gaussian"):
        final, way = difference(last[name], last[best]), difference(areas[name], areas[best])
        found.append(
            Claim(f"Adaptive smoothing ({name.split()[1]}) does better than the best fixed one",
                  _PLACE, "final return and mean over iterations above, 95 % over runs",
                  f"against {best}: final {final}, mean {way}", final.better and way.better,
                  least((final, way)))
        )  # fmt: skip
    shares = [float((last[name] > _REACHED).mean()) for name in last]
    told = ", ".join(f"{name} {share:.0%}" for name, share in zip(last, shares, strict=True))
    found.append(
        Claim("Every method gets to the goal", "our check",
              f"return above {_REACHED:g} m² in all runs, the best being 0", told, min(shares) == 1)
    )  # fmt: skip
    return [*found, *_of_landscapes(data, smoothed)]


def _of_landscapes(data: xr.Dataset, smoothed: list[str]) -> list[Claim]:
    peaks = {str(law): _peaks(data["line"].sel(law=law).values) for law in data["law"].values}
    fewer = [peaks[name] < peaks["FOPG"] for name in smoothed]
    exact = data["landscape"].sel(law="FOPG")
    losses = []
    for name in smoothed:
        top = np.unravel_index(data["landscape"].sel(law=name).values.argmax(), exact.shape)
        losses.append(float(exact.values.max() - exact.values[top]))
    return [
        Claim("The exact law's landscape has local maxima that smoothing removes", "our check",
              f"fewer along the angle than the exact law's {peaks['FOPG']}",
              f"{over(smoothed, fewer)}: {', '.join(str(peaks[n]) for n in smoothed)}", all(fewer)),
        Claim("The best throw under a smoothed law is the best under the exact one", "our check",
              f"exact return of its best decision within {-_REACHED:g} m² of the best",
              f"{over(smoothed, np.array(losses) < -_REACHED)}: less by"
              f" {', '.join(f'{loss:.2g}' for loss in losses)}", max(losses) < -_REACHED),
    ]  # fmt: skip


def _peaks(line: np.ndarray) -> int:
    """Local maxima that stand out by more than a thousandth of the range of values."""
    from scipy.signal import find_peaks

    return len(find_peaks(line, prominence=_PROMINENT * np.ptp(line))[0])
