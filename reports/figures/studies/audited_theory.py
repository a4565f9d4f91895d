"""Drawing of study T1."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from reports.style import BLUE, CYCLE, GREY, VERMILLION, WIDTH

caption = (
    "Top left: how often each bound holds over all sizes. Top right: largest slope and curvature "
    "over mu at four contacts, with the bound of thm. 4.5 as printed. Bottom left: slope over "
    "bound, median and range over the draws. Bottom right: gradient variance over the horizon "
    "(dots), with the growth that thm. 4.4 would allow, L^4H, from the first point (dotted)."
)


def draw(data: xr.Dataset) -> Figure:
    """How often the bounds hold, what scales with mu, how loose they are, and variance."""
    figure = Figure(figsize=(WIDTH, 6.0))
    (often, scaling), (loose, growth) = figure.subplots(2, 2)
    names = [str(name) for name in data["bound"].values[:-1]]
    for index, (kind, color) in enumerate(
        zip(data["kind"].values, (BLUE, VERMILLION), strict=True)
    ):
        ratio = data["ratio"].sel(kind=kind).values[:, :-1]
        share = [
            np.mean(values[np.isfinite(values)] <= 1 + 1e-9) if np.isfinite(values).any() else 0
            for values in ratio.transpose(1, 0, 2).reshape(len(names), -1)
        ]
        place = np.arange(len(names)) + 0.2 - 0.4 * index
        often.barh(place, share, 0.38, color=color)
        scaling.loglog(data["mu"], data["slope"][index], "o-", color=color)
        scaling.loglog(data["mu"], data["curvature"][index], "s--", color=color)
        scaling.loglog(data["mu"], data["printed"][index], ":", color=color)
        own = data["ratio"].sel(kind=kind, bound="5.1").values
        size = data["size"].values + 0.12 - 0.24 * index
        middle = np.median(own, axis=1)
        reach = [middle - own.min(axis=1), own.max(axis=1) - middle]
        loose.errorbar(
            size, middle, reach, fmt="o", color=color, linewidth=0.8, capsize=2, label=str(kind)
        )
    for style, name in (("o-", "slope"), ("s--", "curvature"), (":", "bound as printed")):
        scaling.plot([], [], style, color=GREY, label=name)
    often.set_yticks(np.arange(len(names)), names)
    often.invert_yaxis()
    often.set_xlim(0, 1.02)
    often.set_xlabel("share of systems in which it holds")
    scaling.set(xlabel="$\\mu$", ylabel="largest over systems")
    loose.set_yscale("log")
    loose.axhline(1, color=GREY, linewidth=0.8)
    loose.set(xlabel="number of contacts", ylabel="slope / bound of thm. 5.1")
    horizon = data["horizon"].values
    for index, (gain, color) in enumerate(zip(data["gain"].values, CYCLE, strict=False)):
        row = data["growth"].values[index]
        growth.semilogy(horizon, row, "o-", color=color, label=f"$L_f$ = {gain:g}")
        growth.semilogy(horizon, row[0] * max(gain, 1) ** (4.0 * (horizon - horizon[0])), ":",
                        color=color)  # fmt: skip
    growth.set(xlabel="horizon $H$ [steps]", ylabel="variance of the gradient")
    scaling.legend()
    loose.legend()
    growth.legend()
    return figure
