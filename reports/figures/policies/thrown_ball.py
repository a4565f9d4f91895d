"""Drawing of study A7."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from reports.style import CYCLE, INK, WIDTH

caption = (
    "Above: how much exact return a decision lacks over iterations, median and quartiles over "
    "runs. Below: the return over angle and speed under three laws, light where it is high, with "
    "the iterates of one run, its end (dot) and the goal's throw (cross)."
)
_SHOWN = (("FOPG", "exact"), ("BS 0.01", "barrier, 1e-2"), ("ABS quartic", "adaptive"))
_LEAST = 1e-5


def draw(data: xr.Dataset) -> Figure:
    """Curves of all methods beside the landscapes of three laws."""
    figure = Figure(figsize=(WIDTH, 5.2))
    grid = figure.add_gridspec(2, 3, height_ratios=(1.1, 1))
    curves = figure.add_subplot(grid[0, :])
    colors = {str(m): CYCLE[k % len(CYCLE)] for k, m in enumerate(data["algorithm"].values)}
    for k, (method, color) in enumerate(colors.items()):
        lost = np.maximum(-data["exact_return"].sel(algorithm=method).values, _LEAST)
        low, middle, high = np.quantile(lost, [0.25, 0.5, 0.75], axis=0)
        iterations = np.arange(len(middle))
        style = "-" if k < len(CYCLE) else "--"
        curves.semilogy(iterations, middle, style, color=color, label=method)
        curves.fill_between(iterations, low, high, color=color, alpha=0.12, linewidth=0)
    curves.set_xlabel("iteration")
    curves.set_ylabel("minus return [$m^2$]")
    curves.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    whole = -data["landscape"].sel(law=[law for law, _ in _SHOWN]).values
    levels = np.geomspace(max(whole.min(), 1e-2), whole.max(), 12)
    for k, (law, title) in enumerate(_SHOWN):
        axes = figure.add_subplot(grid[1, k])
        lost = np.maximum(-data["landscape"].sel(law=law).values, levels[0])
        axes.contourf(data["theta"], data["s"], np.log10(lost).T, levels=np.log10(levels),
                      cmap="Greys")  # fmt: skip
        way = data.sel(algorithm=law).isel(run=0)
        axes.plot(way["angle"], way["speed"], ".-", color=colors[law], markersize=2, linewidth=0.8)
        axes.plot(way["angle"][-1], way["speed"][-1], "o", color=colors[law], markersize=5)
        axes.plot([0.6], [3.0], "+", color=INK, markersize=7)
        axes.set_xlim(float(data["theta"].min()), float(data["theta"].max()))
        axes.set_ylim(float(data["s"].min()), float(data["s"].max()))
        axes.set_title(title)
        axes.set_xlabel("angle [rad]")
        if k == 0:
            axes.set_ylabel("speed [m/s]")
    return figure
