"""Drawing of study C1, on contact laws in the closed loop."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure

from problems.studies.laws_in_the_loop.data import FEEDBACK, INPUTS, LAWS, relative_cost, run_settings, survival
from problems.studies.shared.trainings import mean_difference
from reports.drawing.style import FAINT, INK, WIDTH
from reports.figures.studies.panels import drawing
from reports.tables.law_tables import excess_text

_GOOD_EXCESS = 0.1
"""Excess cost, relative to the best controller, at which the colours change from blue to red."""
_EXCESS_RANGE = (1e-3, 100.0)
"""Range of excess costs, relative to the best controller, that the colours span."""


@drawing(
    "What a closed loop costs over the best controller found on the same task, plant and seed: "
    "blue within 10 %, red beyond; the mean over seeds, and below it half of its 95 % interval. A "
    "check mark: all runs survive, at no more than twice the best cost on the model; in brackets: "
    "so many of them do. Left: planning again at every sample under each law, over two horizons. "
    "Right: gains of the linear-quadratic regulator along one plan, and that plan's inputs alone, "
    "over the first horizon. Above each column the median of the times of a sample."
)
def c1(data: xr.Dataset) -> Figure:
    """Draw study C1, two heat maps of excess cost: a row per task and plant, a column per controller."""
    rows = run_settings(data)
    figure = Figure(figsize=(WIDTH, 1.3 + 0.29 * len(rows)))
    planning_axis, gains_axis = figure.subplots(1, 2, width_ratios=(len(LAWS), len(FEEDBACK + INPUTS)))
    _map(planning_axis, data, list(LAWS), "run")
    _map(gains_axis, data, [*FEEDBACK, *INPUTS], "first horizon")
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


def _map(axis: Axes, data: xr.Dataset, names: Sequence[str], span: str) -> None:
    rows, ratio, alive = run_settings(data), relative_cost(data), survival(data)
    norm = TwoSlopeNorm(np.log10(_GOOD_EXCESS), *np.log10(_EXCESS_RANGE))
    log_excess = np.empty((len(rows), len(names)))
    for i, j in np.ndindex(log_excess.shape):
        selection = {"task": rows[i][0], "plant": rows[i][1], "controller": names[j], "span": span}
        costs, n_alive = ratio.sel(selection).values, int(alive.sel(selection).sum())
        mean_excess = mean_difference(costs, np.ones_like(costs))
        log_excess[i, j] = np.log10(np.clip(mean_excess.mean, *_EXCESS_RANGE))
        color = INK if 0.12 < norm(log_excess[i, j]) < 0.88 else "white"
        mark = r" $\checkmark$" if n_alive == len(costs) else f" ({n_alive})" if n_alive else ""
        spread = _spread((mean_excess.high - mean_excess.low) / 2, mean_excess.mean)
        for offset, text in ((-0.2, excess_text(mean_excess.mean)), (0.22, spread + mark)):
            axis.text(j, i + offset, text, ha="center", va="center", color=color, fontsize=7)
    axis.imshow(log_excess, cmap="RdBu_r", norm=norm, aspect="auto", alpha=0.75)
    axis.grid(False)
    axis.tick_params(length=0)
    axis.xaxis.tick_top()
    times = data["ms"].sel(controller=list(names)).median(["task", "plant"]).values
    axis.set_xticks(
        range(len(names)),
        [name.replace(", ", "\n").replace(" ", "\n") + f"\n{ms:.2g} ms" for name, ms in zip(names, times, strict=True)],
        fontsize=7,
    )
    for i in range(1, len(rows)):
        new_task = rows[i][0] != rows[i - 1][0]
        axis.axhline(i - 0.5, color=INK if new_task else FAINT, linewidth=0.8 if new_task else 0.4)


def _spread(half_width: float, mean: float) -> str:
    """Return half the width of an interval as text, like :func:`~reports.tables.law_tables.excess_text`."""
    if mean >= 2:
        return f"±{half_width:.0f}" if half_width >= 9.5 else f"±{half_width:.2g}"
    return f"±{half_width:.1%}" if half_width < 0.0995 else f"±{half_width:.0%}"
