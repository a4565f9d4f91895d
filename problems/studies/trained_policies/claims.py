"""Claims of A4 on the speed of learning, on running, and on plans."""

from __future__ import annotations

from dataclasses import replace

import xarray as xr

from problems.studies.shared.trainings import claim_gains, mean_difference, mean_height
from problems.studies.study import Claim, claim, settings_text
from problems.studies.trained_policies.data import MODEL_BASED, NETWORK, SHOWN, STEPS

_EQUAL_RETURN = 1e-2
"""Relative difference up to which the returns of a plan and of its replay count as equal."""
_FIGURE_4 = "ABS, sec. 7.3, fig. 4"
"""Citation in the claims from the paper."""
_OURS = "FOPG-ABS"
"""Name of the method proposed in the paper."""
_RUNNING_SPEEDS = {"hopper": 1.0, "half-cheetah": 1.5}
"""Mapping from each task to the minimum mean forward speed [m/s] at which a policy counts as running."""


def claims(data: xr.Dataset) -> list[Claim]:
    """Return claims on FOPG with ABS, on running policies, and on plans."""
    papers = [str(name) for name in data["algorithm"].values if name not in (NETWORK, SHOWN)]
    others = [name for name in papers if name not in (_OURS, MODEL_BASED)]
    results = []
    for task in map(str, data["task"].values):
        results += _of_plans(task, data.sel(task=task))
        task_data = data.sel(task=task, algorithm=papers)
        areas = {n: mean_height(task_data["by_steps"].sel(algorithm=n).values) for n in (_OURS, *others)}
        gains = [mean_difference(areas[_OURS], areas[name], paired=False) for name in others]
        best = {n: task_data["best"].sel(algorithm=n).values for n in papers}
        ends = [mean_difference(best[_OURS], best[name], paired=False) for name in others]
        rivalry = [
            claim_gains(
                f"On {task} FOPG with ABS learns the fastest",
                _FIGURE_4,
                "mean return over equal simulated steps above every other's, bootstrap 95 %",
                others,
                gains,
            ),
            claim_gains(
                f"On {task} FOPG with ABS ends the highest",
                _FIGURE_4,
                "best return in equal simulated steps above every other's, bootstrap 95 %",
                others,
                ends,
            ),
        ]
        untrained_text = _untrained(task_data)
        results += [replace(claim, measured=claim.measured + untrained_text) for claim in rivalry]
        running = task_data["speed"].median("run").values >= _RUNNING_SPEEDS[task]
        lasting = task_data["length"].median("run").values >= 100
        speeds = ", ".join(f"{s:.2f}" for s in task_data["speed"].median("run").values)
        results.append(
            claim(f"Every algorithm's best policy runs on {task}", "our check")
            .expected(f"half of the seeds at {_RUNNING_SPEEDS[task]:g} m/s or more for 5 s, without falling")
            .measured(f"{settings_text(papers, running & lasting)}: {speeds} m/s")
            .holds(running & lasting)
        )
    return results


def _untrained(task_data: xr.Dataset) -> str:
    """Return a text with the algorithms whose best policy is the initial one in every run; empty if there are none."""
    initial = (task_data["best"] <= task_data["by_steps"].isel(steps=0)).all("run")
    names = ", ".join(map(str, task_data["algorithm"].values[initial.values]))
    return f"; never above their initial policy: {names}" if names else ""


def _of_plans(task: str, task_data: xr.Dataset) -> list[Claim]:
    """Check whether learning from a fit to plans is faster, and whether a policy has a higher return than plans."""
    areas = [mean_height(task_data["by_steps"].sel(algorithm=name).values) for name in (SHOWN, NETWORK)]
    gain = mean_difference(*areas, paired=False)
    best = task_data["replayed"].max("guess")
    shares = task_data["reached"].median("run").mean("start") / best.mean("start")
    names = [str(name) for name in task_data["algorithm"].values]
    share_texts = ", ".join(f"{name} {share:.0%}" for name, share in zip(names, shares.values, strict=True))
    certified = task_data["certified"].astype(bool)
    replays_differently = abs(task_data["planned"] - task_data["replayed"]) > _EQUAL_RETURN * abs(task_data["replayed"])
    return [
        claim(f"On {task} a network that starts from plans learns faster than a random one", "our check")
        .expected("mean return over equal simulated steps above, bootstrap 95 %")
        .measured(str(gain))
        .holds(gain.better, margin=gain.margin),
        claim(f"On {task} no policy is above the best plan found from the same starts", "our check")
        .expected(f"share of the best plan's exact return over {STEPS} steps at most 100 %")
        .measured(
            f"{share_texts}; of {certified.size} plans {int(certified.sum())} certified,"
            f" {int((certified & replays_differently).sum())} of these replay to another return"
        )
        .at_most(shares, 1),
    ]
