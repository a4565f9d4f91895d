"""What A4's data say of fig. 4."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.shared.compared_runs import Difference, area, difference
from problems.studies.study import Claim, over

_PLACE = "ABS, sec. 7.3, fig. 4"
_OURS = "FOPG-ABS"
_FAST = {"hopper": 1.0, "half-cheetah": 1.5}
"""Mean forward speed of a policy that runs [m/s]."""


def claims(data: xr.Dataset) -> list[Claim]:
    """Whether the adaptive law is on top, by area and by end, and which policies run."""
    others = [str(name) for name in data["algorithm"].values if name != _OURS]
    found = []
    for task in map(str, data["task"].values):
        one = data.sel(task=task)
        areas = {n: _area(one["by_steps"].sel(algorithm=n).values) for n in (_OURS, *others)}
        gains = [difference(areas[_OURS], areas[name], paired=False) for name in others]
        best = {n: one["best"].sel(algorithm=n).values for n in (_OURS, *others)}
        ends = [difference(best[_OURS], best[name], paired=False) for name in others]
        found += [
            Claim(f"On {task} FOPG with ABS learns the fastest", _PLACE,
                  "mean return over simulated steps above every other's, bootstrap 95 %",
                  _told(others, gains), all(g.better for g in gains)),
            Claim(f"On {task} FOPG with ABS ends the highest", _PLACE,
                  "best return above every other's, bootstrap 95 %",
                  _told(others, ends), all(g.better for g in ends)),
        ]  # fmt: skip
        running = one["speed"].median("run").values >= _FAST[task]
        lasting = one["length"].median("run").values >= 100
        names = [str(name) for name in data["algorithm"].values]
        speeds = ", ".join(f"{s:.2f}" for s in one["speed"].median("run").values)
        found.append(
            Claim(f"Every algorithm's best policy runs on {task}", "our check",
                  f"half of the seeds at {_FAST[task]:g} m/s or more for 5 s, without falling",
                  f"{over(names, running & lasting)}: {speeds} m/s",
                  bool(np.all(running & lasting)))
        )  # fmt: skip
    return found


def _area(curve: np.ndarray) -> np.ndarray:
    """Mean of curves (runs, points) where all have begun."""
    begun = np.isfinite(curve).all(axis=0)
    return area(curve[:, begun])


def _told(others: list[str], gains: list[Difference]) -> str:
    differences = ", ".join(str(gain) for gain in gains)
    return f"{over(others, [gain.better for gain in gains])}: {differences}"
