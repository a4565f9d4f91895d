"""Drawing of study N3."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from problems.studies.smoothings_compared.data import ANALYTIC, WITHIN, described, excess, gap
from reports.figures.studies.panels import Drawing
from reports.smoothings import dearer, seconds_of, short
from reports.style import CYCLE, GREY, INK, WIDTH

_LEAST, _MOST = 1e-3, 100.0
"""Excesses at which the colours end."""


def _draw(data: xr.Dataset) -> Figure:
    """The table, and below it what trust does."""
    figure = Figure(figsize=(WIDTH, 7.6))
    parts: Any = figure.subfigures(2, 1, height_ratios=(2.5, 1))
    table, trust = parts
    costs, seconds = table.subplots(1, 2, width_ratios=(1.75, 1))
    _costs(costs, data)
    _seconds(seconds, data)
    left, right = trust.subplots(1, 2)
    cost = data["trusting_cost"]
    _over_share(left, data, 1 + gap(cost), "replay / plan")
    _over_share(right, data, cost.sel(motion="exact replay") / data["rest"], "replay / at rest")
    trust.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def _costs(axis: Axes, data: xr.Dataset) -> None:
    shown = excess(data).median("seed").transpose("law", "problem").values
    best = data["cost"].sel(law="exact", motion="exact replay")
    promised = (data["cost"].sel(motion="plan") / best - 1).median("seed")
    plans = promised.transpose("law", "problem").values
    lives, of = data["survives"].sum("seed").transpose("law", "problem").values, data.sizes["seed"]
    norm = TwoSlopeNorm(np.log10(WITHIN), np.log10(_LEAST), np.log10(_MOST))
    heights = np.log10(np.clip(shown, _LEAST, _MOST))
    axis.imshow(heights, cmap="RdBu_r", norm=norm, aspect="auto", alpha=0.75)
    for row, column in np.ndindex(shown.shape):
        light = 0.12 < norm(heights[row, column]) < 0.88
        style: dict[str, Any] = {"ha": "center", "va": "center", "color": INK if light else "white"}
        word = dearer(float(shown[row, column])) + _mark(int(lives[row, column]), of)
        axis.text(column, row - 0.16, word, **style)
        axis.text(column, row + 0.25, f"plan {dearer(float(plans[row, column]))}", fontsize=6,
                  **style)  # fmt: skip
    _grid(axis, data)
    axis.set_yticks(range(data.sizes["law"]), list(described(data.attrs).values()))
    axis.set_title("exact replay over the exact optimum")


def _mark(lives: int, of: int) -> str:
    """A check mark where plans survive, with their number where not all do."""
    if lives == 0:
        return ""
    return r" $\checkmark$" if lives == of else rf" $\checkmark${lives}/{of}"


def _seconds(axis: Axes, data: xr.Dataset) -> None:
    spent = seconds_of(data).transpose("law", "problem").values
    axis.imshow(np.log10(spent), cmap="Greys", aspect="auto", vmin=-1.5, vmax=2.5, alpha=0.6)
    for (row, column), value in np.ndenumerate(spent):
        axis.text(column, row, f"{value:.2g}", ha="center", va="center", color=INK)
    _grid(axis, data)
    axis.set_yticks([])
    axis.set_title("processor [s]")


def _grid(axis: Axes, data: xr.Dataset) -> None:
    """Name the columns, and part the exact law, the analytic ones and the learned ones."""
    axis.grid(False)
    axis.tick_params(length=0)
    axis.xaxis.tick_top()
    axis.set_xticks(range(data.sizes["problem"]), [short(str(p)) for p in data["problem"].values])
    for line in (0.5, len(ANALYTIC) + 0.5):
        axis.axhline(line, color=INK, linewidth=0.9)


def _over_share(axis: Axes, data: xr.Dataset, values: xr.DataArray, label: str) -> None:
    shares = data["share"].values
    places = np.arange(len(shares))
    for name, color in zip(data["problem"].values, CYCLE, strict=False):
        rows = values.sel(problem=name).transpose("seed", "share").values
        axis.plot(places, np.median(rows, axis=0), "o-", color=color, label=str(name))
        axis.fill_between(places, rows.min(axis=0), rows.max(axis=0), color=color, alpha=0.12,
                          linewidth=0)  # fmt: skip
    axis.axhline(1, color=GREY, linewidth=0.8, linestyle="--")
    axis.set(yscale="log", xlabel="weight of trust", ylabel=label)
    axis.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.yaxis.set_minor_locator(NullLocator())
    axis.set_xticks(places, [f"{share:g}" for share in shares])


DRAWING = Drawing(
    _draw,
    "Top left: what the plan of every law costs when it is replayed under the exact law, over the "
    "exact law's own optimum; blue within 10 %, red beyond. Small: what the plan promised on its "
    "own model, over the same optimum; a check mark: the referee lets the plan survive. Top right: "
    "seconds of the processor, collecting and training included. Medians over seeds, how many "
    "of them survive. Bottom: the average of data with trust over its weight beta, as a share of a "
    "step's cost at rest, median and range over seeds; left how much dearer the replay is than the "
    "plan, right what the replay costs, as a share of standing still.",
)
