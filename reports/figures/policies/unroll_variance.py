"""Drawing of study A3."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from problems.studies.unroll_variance import growth
from reports.style import CYCLE, INK, WIDTH

caption = (
    "Left: variance of one unroll's gradient, mean over the policies of a training (band: their "
    "range). Right: growth of its logarithm a step from H = 5 on, with twice its standard error."
)


def draw(data: xr.Dataset) -> Figure:
    """Variances over the length, and growth rates by law."""
    figure = Figure(figsize=(WIDTH, 4.6))
    tasks, laws = list(map(str, data["task"].values)), list(map(str, data["law"].values))
    panels = figure.subplots(len(tasks), 2, width_ratios=(1.6, 1))
    lengths = data["length"].values
    for (curves, rates), task in zip(panels, tasks, strict=True):
        for k, (law, color) in enumerate(zip(laws, CYCLE, strict=False)):
            values = data["variance"].sel(task=task, law=law).values
            style = "--" if law == "adaptive" else "-"
            label = law if task == tasks[0] else None
            curves.semilogy(lengths, np.nanmean(values, axis=0), style, color=color, label=label)
            curves.fill_between(lengths, np.nanmin(values, axis=0), np.nanmax(values, axis=0),
                                color=color, alpha=0.07, linewidth=0)  # fmt: skip
            found = growth(data, task, law)
            rates.errorbar([k], [found.rate], yerr=[[found.rate - found.low]], fmt="o",
                           color=color, markersize=4)  # fmt: skip
        rates.axhline(0, color=INK, linewidth=0.6)
        rates.set_xticks(range(len(laws)), laws, rotation=45)
        curves.set_title(task)
        curves.set_ylabel("variance")
        rates.set_ylabel("growth [1/step]")
    panels[-1][0].set_xlabel("unroll length H")
    figure.legend(loc="outside upper center", ncols=6)
    return figure
