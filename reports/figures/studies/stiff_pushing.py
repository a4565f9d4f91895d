"""Drawing of study P5."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from reports.style import BLUE, GREEN, INK, VERMILLION, WIDTH

caption = (
    "Variance of the gradient by all inputs over the stiffness of the spring; the vertical line is "
    "the analytic limit of semi-implicit integration. Horizontal: implicit time stepping, which "
    "has no stiffness, under the exact law (full) and softened (dotted)."
)


def draw(data: xr.Dataset) -> Figure:
    """Variance over k."""
    figure = Figure(figsize=(WIDTH, 3.6))
    axis = figure.subplots()
    k = data["k"].values
    axis.loglog(k, data["first_order"], "o-", color=BLUE, label="FoBG, spring")
    axis.loglog(k, data["zeroth_order"], "s-", color=VERMILLION, label="ZoBG, spring")
    implicit = data["implicit_first"].values
    axis.axhline(implicit[0], color=GREEN, label="FoBG, implicit time stepping")
    for value in implicit[1:]:
        axis.axhline(value, color=GREEN, linestyle=":", linewidth=1.0)
    limit = float(data["limit"])
    axis.axvline(limit, color=INK, linestyle="--", linewidth=0.9)
    axis.text(limit * 0.93, 1e12, "$m (1 + c)/h^2$", rotation=90, ha="right", va="center")
    finite = np.concatenate((data["first_order"].values, implicit))
    axis.set_ylim(np.nanmin(finite) / 3, 1e20)
    axis.set(xlabel="stiffness $k$ [N/m]", ylabel="variance [m$^4$/N$^2$]")
    axis.legend(loc="upper left")
    return figure
