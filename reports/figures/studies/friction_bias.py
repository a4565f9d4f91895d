"""Drawing of study P3."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from reports.style import CYCLE, INK, WIDTH

caption = (
    "Relaxed friction over sliding velocity, and the impulse on a block behind it (dashed); "
    "estimates over sample count; empirical variance over slip tolerance (marks: 1000 samples, "
    "crosses: many, lines: closed forms), and that of the block."
)


def draw(data: xr.Dataset) -> Figure:
    """Friction, running estimates, and variances over the tolerance."""
    figure = Figure(figsize=(WIDTH, 4.8))
    (friction, running), (variance, block) = figure.subplots(2, 2)
    slip = data["slip"].values
    for color, nu in zip(CYCLE, data["width"].values, strict=False):
        one = data.sel(width=nu)
        friction.plot(slip, one["friction"], color=color, label=f"$\\nu$ = {nu:g} m/s")
        friction.plot(slip, one["block_impulse"], "--", color=color)
    friction.set(xlabel="sliding velocity [m/s]", ylabel="share of the limit")
    friction.legend()
    for color, name in zip(CYCLE, data["order"].values, strict=False):
        running.plot(data["n"], data["running_mean"].sel(order=name), color=color, label=str(name))
        few = data["variance"].sel(order=name).values
        shown = few > 0
        variance.loglog(data["nu"][shown], few[shown], ".", color=color, label=str(name))
        variance.loglog(data["nu"], data[f"{name}_variance"], color=color)
        for axis, grid, mark, many in (
            (variance, "coarse", "x", "wide_variance"),
            (block, "block_nu", "x-", "block_variance"),
        ):
            values = data[many].sel(order=name).values
            axis.loglog(data[grid], np.where(values > 0, values, np.nan), mark, color=color)
    running.axhline(float(data["truth"]), color=INK, linewidth=0.8, linestyle="--")
    running.set_ylim(-5, 4 * float(data["truth"]))
    running.set(xlabel="samples", ylabel="gradient [s/m]")
    running.legend()
    variance.set_ylabel("variance of one sample [s$^2$/m$^2$]")
    variance.set_title("relaxed friction")
    block.set_title("block on a belt")
    for axis in (variance, block):
        axis.set_xlabel("slip tolerance $\\nu$ [m/s]")
    return figure
