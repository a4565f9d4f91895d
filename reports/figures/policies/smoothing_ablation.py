"""Drawing of study A5."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from reports.style import CYCLE, WIDTH

caption = (
    "Left: return of whole episodes under the exact law, median over seeds and middle half. Right: "
    "variance of one unroll's gradient, median over seeds."
)


def draw(data: xr.Dataset) -> Figure:
    """Returns and gradient variances over iterations."""
    figure = Figure(figsize=(WIDTH, 3.2))
    returns, spread = figure.subplots(1, 2, width_ratios=(1.4, 1))
    iterations = data["iteration"].values
    for law, color in zip(map(str, data["law"].values), CYCLE, strict=False):
        one = data.sel(law=law)
        low, middle, high = np.quantile(one["exact_return"].values, [0.25, 0.5, 0.75], axis=0)
        returns.plot(iterations, middle, color=color, label=law)
        returns.fill_between(iterations, low, high, color=color, alpha=0.12, linewidth=0)
        spread.semilogy(np.nanmedian(one["variance"].values, axis=0), color=color)
    returns.set_xlabel("iteration")
    returns.set_ylabel("exact return")
    spread.set_xlabel("iteration")
    spread.set_ylabel("variance of the gradient")
    figure.legend(loc="outside upper center", ncols=6)
    return figure
