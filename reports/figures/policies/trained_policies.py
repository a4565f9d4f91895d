"""Drawing of study A4."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.style import CYCLE, WIDTH

caption = (
    "Returns of whole episodes under the exact law: median over seeds, and the range of the middle "
    "half, over simulated steps and over wall time."
)


def draw(data: xr.Dataset) -> Figure:
    """Curves over steps and over time, a row a task."""
    figure = Figure(figsize=(WIDTH, 4.8))
    tasks = list(map(str, data["task"].values))
    rows = figure.subplots(len(tasks), 2, sharey="row", squeeze=False)
    for row, task in zip(rows, tasks, strict=True):
        one = data.sel(task=task)
        curves(row[0], one["by_steps"], "algorithm", "steps", named=task == tasks[0])
        curves(row[1], one["by_time"], "algorithm", "wall", named=False)
        row[0].set_ylabel("exact return")
        row[0].set_title(task)
    rows[-1][0].set_xlabel("simulated steps")
    rows[-1][1].set_xlabel("wall time [s]")
    figure.legend(loc="outside upper center", ncols=7)
    return figure


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
