"""Drawing of study A4."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from problems.studies.trained_policies.data import METHODS, MODEL_BASED
from reports.style import CYCLE, WIDTH

caption = (
    "Returns of whole episodes under the exact law: median over seeds, and the range of the middle "
    "half, over the simulated steps that all spend, over MBPO's own and over wall time. Below, "
    "every seed's policy over the steps of a plan from the same starts, as a share of what the "
    "best plan's inputs return."
)


def draw(data: xr.Dataset) -> Figure:
    """Curves over steps and over time, a row a task; then shares of the best plan."""
    figure = Figure(figsize=(WIDTH, 7.2))
    tasks = list(map(str, data["task"].values))
    parts: Any = figure.subfigures(2, 1, height_ratios=[2 * len(tasks), 1.6])
    above, below = parts
    rows = above.subplots(len(tasks), 3, squeeze=False, sharey="row", width_ratios=[2, 0.9, 1.3])
    for row, task in zip(rows, tasks, strict=True):
        one, first = data.sel(task=task), task == tasks[0]
        curves(row[0], one["by_steps"].drop_sel(algorithm=MODEL_BASED), "steps", named=first)
        alone = one["model_based"].expand_dims(algorithm=[MODEL_BASED])
        curves(row[1], alone, "few", named=first)
        curves(row[2], one["by_time"], "wall", named=False)
        row[0].set_ylabel("exact return")
        row[0].set_title(task)
        row[0].set_xlabel("simulated steps")
        row[1].set_xlabel("steps of MBPO")
        row[2].set_xlabel("wall time [s]")
    for axes, task in zip(below.subplots(1, len(tasks), sharey=True), tasks, strict=True):
        shares(axes, data.sel(task=task))
        axes.set_title(task)
        axes.set_xlabel("share of the best plan's return")
    above.legend(loc="outside upper center", ncols=4)
    return figure


def shares(axes: Axes, one: xr.Dataset) -> None:
    """Every run's share of the best plan, a line an algorithm, the median as a stroke."""
    best = one["replayed"].max("guess").mean("start")
    found = (one["reached"].mean("start") / best).transpose("algorithm", "run").values
    for k, of in enumerate(found):
        axes.plot(of, np.full(of.shape, k), "o", color=CYCLE[k % len(CYCLE)], ms=3, alpha=0.6)
        axes.plot(np.median(of), k, "|", color=CYCLE[k % len(CYCLE)], ms=9)
    axes.axvline(1.0, color="0.6", linewidth=0.8)
    axes.set_yticks(range(len(found)), [str(name) for name in one["algorithm"].values])
    axes.set_ylim(len(found) - 0.5, -0.5)


def curves(axes: Axes, data: xr.DataArray, along: str, named: bool) -> None:
    """Median and middle half over runs of ``data`` (algorithm, run, along), where all have been."""
    for name in map(str, data["algorithm"].values):
        values = data.sel(algorithm=name).transpose("run", along).values
        been = np.isfinite(values).all(axis=0)
        low, middle, high = np.quantile(values[:, been], [0.25, 0.5, 0.75], axis=0)
        k = list(METHODS).index(name)
        style, color = "-" if k < len(CYCLE) else "--", CYCLE[k % len(CYCLE)]
        at = data[along].values[been]
        axes.plot(at, middle, style, color=color, label=name if named else None)
        axes.fill_between(at, low, high, color=color, alpha=0.12, linewidth=0)
