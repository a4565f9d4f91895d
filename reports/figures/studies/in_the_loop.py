"""Drawing of study C1, on contact laws in the closed loop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from problems.studies.laws_in_the_loop.data import FEEDBACK, INPUTS, LAWS, relative_cost, run_settings, survival
from problems.studies.shared.trainings import mean_difference
from reports.drawing.style import FAINT, INK, WIDTH
from reports.figures.studies.panels import drawing, excess_map, label_columns
from reports.tables.law_tables import excess_text

_GOOD_EXCESS = 0.1
"""Excess cost, relative to the best controller, where the colours change from blue to red."""


@drawing(
    "Cost of closed loops relative to the best controller found for the same task, plant and seed: "
    "blue within 10 %, red beyond. Each cell shows the mean over seeds and half of its 95 % "
    "interval. A check mark means that all runs survive at no more than twice the best cost on the "
    "model; a number in brackets counts those that do. Left: replanning at every sample under each "
    "law, over two horizons. Right: gains of the linear-quadratic regulator along one plan, and that "
    "plan's inputs alone, over the first horizon. The median time of a sample is above each column."
)
def c1(data: xr.Dataset) -> Figure:
    """Draw study C1: two heat maps of excess cost, with a row per task and plant and a column per controller."""
    rows = run_settings(data)
    figure = Figure(figsize=(WIDTH, 1.3 + 0.29 * len(rows)))
    planning_axis, gains_axis = figure.subplots(1, 2, width_ratios=(len(LAWS), len(FEEDBACK + INPUTS)))
    _excess_table(planning_axis, data, list(LAWS), "run")
    _excess_table(gains_axis, data, [*FEEDBACK, *INPUTS], "first horizon")
    planning_axis.set_yticks(range(len(rows)), [plant for _, plant in rows])
    first_rows = [i for i, row in enumerate(rows) if i == 0 or row[0] != rows[i - 1][0]]
    for first, end in zip(first_rows, [*first_rows[1:], len(rows)], strict=True):
        planning_axis.text(
            -0.2,
            (first + end - 1) / 2,
            rows[first][0],
            rotation=90,
            ha="center",
            va="center",
            transform=planning_axis.get_yaxis_transform(),
        )
    gains_axis.set_yticks([])
    planning_axis.set_title("planning again")
    gains_axis.set_title("one plan, first horizon")
    return figure


def _excess_table(axis: Axes, data: xr.Dataset, names: Sequence[str], span: str) -> None:
    rows, ratio, alive = run_settings(data), relative_cost(data), survival(data)
    excess, texts = np.empty((len(rows), len(names))), {}
    for i, j in np.ndindex(excess.shape):
        selection = {"task": rows[i][0], "plant": rows[i][1], "controller": names[j], "span": span}
        costs, n_alive = ratio.sel(selection).values, int(alive.sel(selection).sum())
        mean_excess = mean_difference(costs, np.ones_like(costs))
        excess[i, j] = mean_excess.mean
        mark = r" $\checkmark$" if n_alive == len(costs) else f" ({n_alive})" if n_alive else ""
        spread = _spread((mean_excess.high - mean_excess.low) / 2, mean_excess.mean)
        texts[i, j] = excess_text(mean_excess.mean), spread + mark
    for (i, j), color in np.ndenumerate(excess_map(axis, excess, _GOOD_EXCESS)):
        for offset, text in zip((-0.2, 0.22), texts[i, j], strict=True):
            axis.text(j, i + offset, text, ha="center", va="center", color=color, fontsize=7)
    times = data["ms"].sel(controller=list(names)).median(["task", "plant"]).values
    lines = [name.replace(", ", "\n").replace(" ", "\n") for name in names]
    label_columns(axis, [f"{name}\n{ms:.2g} ms" for name, ms in zip(lines, times, strict=True)], fontsize=7)
    for i in range(1, len(rows)):
        new_task = rows[i][0] != rows[i - 1][0]
        axis.axhline(i - 0.5, color=INK if new_task else FAINT, linewidth=0.8 if new_task else 0.4)


def _spread(half_width: float, mean: float) -> str:
    """Return half the width of an interval as text, like :func:`~reports.tables.law_tables.excess_text`."""
    if mean >= 2:
        return f"±{half_width:.0f}" if half_width >= 9.5 else f"±{half_width:.2g}"
    return f"±{half_width:.1%}" if half_width < 0.0995 else f"±{half_width:.0%}"
