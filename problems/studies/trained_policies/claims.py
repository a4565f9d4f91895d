"""What A4's data say of fig. 4."""

from __future__ import annotations

import numpy as np
import xarray as xr

from problems.studies.shared.trainings import area, difference, gained
from problems.studies.study import Claim, over
from problems.studies.trained_policies.data import MODEL_BASED, NETWORK, SHOWN, STEPS

_SAME = 1e-2
"""Relative difference up to which a plan and its replay have one return."""
_PLACE = "ABS, sec. 7.3, fig. 4"
_OURS = "FOPG-ABS"
_FAST = {"hopper": 1.0, "half-cheetah": 1.5}
"""Mean forward speed of a policy that runs [m/s]."""


def claims(data: xr.Dataset) -> list[Claim]:
    """Whether the adaptive law is on top, by area and by end, and which policies run."""
    papers = [str(name) for name in data["algorithm"].values if name not in (NETWORK, SHOWN)]
    others = [name for name in papers if name not in (_OURS, MODEL_BASED)]
    found = []
    for task in map(str, data["task"].values):
        found += _of_plans(task, data.sel(task=task))
        one = data.sel(task=task, algorithm=papers)
        areas = {n: area(one["by_steps"].sel(algorithm=n).values) for n in (_OURS, *others)}
        gains = [difference(areas[_OURS], areas[name], paired=False) for name in others]
        best = {n: one["best"].sel(algorithm=n).values for n in papers}
        ends = [difference(best[_OURS], best[name], paired=False) for name in others]
        found += [
            gained(f"On {task} FOPG with ABS learns the fastest", _PLACE,
                   "mean return over equal simulated steps above every other's, bootstrap 95 %",
                   others, gains),
            gained(f"On {task} FOPG with ABS ends the highest", _PLACE,
                   "best return in equal simulated steps above every other's, bootstrap 95 %",
                   others, ends),
        ]  # fmt: skip
        running = one["speed"].median("run").values >= _FAST[task]
        lasting = one["length"].median("run").values >= 100
        speeds = ", ".join(f"{s:.2f}" for s in one["speed"].median("run").values)
        found.append(
            Claim(f"Every algorithm's best policy runs on {task}", "our check",
                  f"half of the seeds at {_FAST[task]:g} m/s or more for 5 s, without falling",
                  f"{over(papers, running & lasting)}: {speeds} m/s",
                  bool(np.all(running & lasting)))
        )  # fmt: skip
    return found


def _of_plans(task: str, one: xr.Dataset) -> list[Claim]:
    """What plans are good for: a start to learn from, and a measure of what was learned."""
    areas = [area(one["by_steps"].sel(algorithm=name).values) for name in (SHOWN, NETWORK)]
    gain = difference(*areas, paired=False)
    best = one["replayed"].max("guess")
    shares = one["reached"].median("run").mean("start") / best.mean("start")
    names = [str(name) for name in one["algorithm"].values]
    told = ", ".join(
        f"{name} {share:.0%}" for name, share in zip(names, shares.values, strict=True)
    )
    certified = one["certified"].astype(bool)
    off = abs(one["planned"] - one["replayed"]) > _SAME * abs(one["replayed"])
    return [
        Claim(f"On {task} a network begun at plans learns faster than one by chance", "our check",
              "mean return over equal simulated steps above, bootstrap 95 %", str(gain),
              gain.better, gain.margin),
        Claim(f"On {task} no policy is above the best plan found from the same starts", "our check",
              f"share of the best plan's exact return over {STEPS} steps at most 100 %",
              f"{told}; of {certified.size} plans {int(certified.sum())} certified,"
              f" {int((certified & off).sum())} of these replay to another return",
              bool((shares <= 1).all())),
    ]  # fmt: skip
