"""Drawing of study A4."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.style import CYCLE, WIDTH

caption = (
    "Returns of whole episodes under the exact law: median over seeds, and the range of the middle "
    "half, over simulated steps and over wall time. Below, every seed's policy over the steps of a "
    "plan from the same starts, as a share of what the best plan's inputs return."
)


def draw(data: xr.Dataset) -> Figure:
    """Curves over steps and over time, a row a task; then shares of the best plan."""
    figure = Figure(figsize=(WIDTH, 7.2))
    tasks = list(map(str, data["task"].values))
    rows = figure.subplots(len(tasks) + 1, 2, squeeze=False, height_ratios=[2] * len(tasks) + [1.6])
    for row, task in zip(rows, tasks, strict=False):
        one = data.sel(task=task)
        curves(row[0], one["by_steps"], "algorithm", "steps", named=task == tasks[0])
        curves(row[1], one["by_time"], "algorithm", "wall", named=False)
        row[1].sharey(row[0])
        row[1].tick_params(labelleft=False)
        row[0].set_ylabel("exact return")
        row[0].set_title(task)
        row[0].set_xlabel("simulated steps")
        row[1].set_xlabel("wall time [s]")
    for axes, task in zip(rows[-1], tasks, strict=True):
        shares(axes, data.sel(task=task))
        axes.set_title(task)
    rows[-1][0].set_xlabel("share of the best plan's return")
    rows[-1][1].set_xlabel("share of the best plan's return")
    rows[-1][1].tick_params(labelleft=False)
    figure.legend(loc="outside upper center", ncols=4)
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
    axes.invert_yaxis()


def curves(axes: Axes, data: xr.DataArray, each: str, along: str, named: bool = True) -> None:
    """Median and middle half over runs of ``data`` (each, run, along), on a logarithmic axis."""
    for k, name in enumerate(map(str, data[each].values)):
        values = data.sel({each: name}).transpose("run", along).values
        begun = np.isfinite(values).all(axis=0)
        low, middle, high = np.quantile(values[:, begun], [0.25, 0.5, 0.75], axis=0)
        style, color = "-" if k < len(CYCLE) else "--", CYCLE[k % len(CYCLE)]
        at = data[along].values[begun]
        axes.semilogx(at, middle, style, color=color, label=name if named else None)
        axes.fill_between(at, low, high, color=color, alpha=0.12, linewidth=0)
