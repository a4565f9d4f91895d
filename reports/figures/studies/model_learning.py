"""Drawing of study AM."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.figures.studies.panels import Drawing
from reports.style import BLUE, FAINT, GREEN, GREY, INK, ORANGE, PURPLE, VERMILLION, WIDTH

_COLORS = {"psi": BLUE, "network": VERMILLION}
_KINDS = {"exact": BLUE, "noise": GREEN, "drag": ORANGE}
_REACH = (0.2, 5.0)


def _draw(data: xr.Dataset) -> Figure:
    """Errors above, the search in the middle, psi below."""
    figure = Figure(figsize=(WIDTH, 7.4))
    grid = figure.add_gridspec(3, 2, height_ratios=(1.2, 0.9, 1.0))
    _over_transitions(figure.add_subplot(grid[0, 0]), data)
    _kinds(figure.add_subplot(grid[0, 1]), data)
    _way(figure.add_subplot(grid[1, :]), data)
    _values(figure.add_subplot(grid[2, :]), data)
    return figure


def _over_transitions(axis: Axes, data: xr.Dataset) -> None:
    n = data["transitions"].values
    for model in data["model"].values:
        color = _COLORS[str(model)]
        for where, style in (("all", "-"), ("contact", "--")):
            found = data["errors"].sel(data="exact", model=model, where=where).values
            some = ~np.isnan(found).all(axis=1)
            found = found[some]
            label = str(model) if where == "all" else f"{model}, contact"
            axis.plot(n[some], np.median(found, axis=1), style, marker="o", color=color,
                      label=label)  # fmt: skip
            if where == "all":
                axis.fill_between(n[some], found.min(axis=1), found.max(axis=1), color=color,
                                  alpha=0.2, linewidth=0)  # fmt: skip
    axis.axhline(float(data["still"].sel(data="exact", where="all")), color=GREY,
                 linestyle=":", label="nothing moves")  # fmt: skip
    axis.set(xscale="log", yscale="log", xlabel="transitions learned from",
             ylabel="mean one-step error")  # fmt: skip
    axis.set_ylim(bottom=1e-8)
    axis.legend(loc="lower left", ncols=2)


def _kinds(axis: Axes, data: xr.Dataset) -> None:
    at = data["errors"].sel(transitions=data.attrs["data"])
    kinds, wheres = [str(kind) for kind in data["data"].values], ("flight", "contact")
    for offset, (model, where) in zip(
        (-0.3, -0.1, 0.1, 0.3), ((m, w) for m in _COLORS for w in wheres), strict=True
    ):
        found = at.sel(model=model, where=where).values
        axis.bar(np.arange(len(kinds)) + offset, np.median(found, axis=1), 0.19,
                 color=_COLORS[model], alpha=0.5 if where == "flight" else 1.0,
                 label=f"{model}, {where}")  # fmt: skip
        for place, each in enumerate(found):
            axis.plot(np.full(each.size, place + offset), each, ".", color=INK, markersize=3)
    axis.set(yscale="log", xticks=range(len(kinds)), ylabel="mean one-step error")
    axis.set_xticklabels(kinds)
    axis.set_ylim(top=30 * float(at.max()))
    axis.legend(loc="upper left", ncols=2)


def _way(axis: Axes, data: xr.Dataset) -> None:
    way = data["way"].isel(seed=0)
    for name in data["parameter"].values:
        color = {"friction": VERMILLION, "spring": GREEN, "damping": PURPLE}.get(str(name), FAINT)
        label = str(name) if color != FAINT else None
        axis.plot(data["iteration"].values, way.sel(parameter=name).values,
                  color=GREY if label is None else color, label=label,
                  linewidth=0.6 if label is None else 1.2)  # fmt: skip
    axis.plot([], [], color=GREY, linewidth=0.6, label="masses, inertias")
    axis.axhline(1, color=INK, linewidth=0.6)
    axis.set(yscale="log", xlabel="iteration of the random search", ylabel="psi / truth")
    _plain(axis, (0.25, 0.5, 1, 2, 4))
    axis.legend(loc="upper right", ncols=4)


def _values(axis: Axes, data: xr.Dataset) -> None:
    at = data.sel(transitions=data.attrs["data"])
    names, seeds = [str(name) for name in data["parameter"].values], data.sizes["seed"]
    for group, (kind, color) in enumerate(_KINDS.items()):
        for seed in range(seeds):
            own = at.sel(data=kind).isel(seed=seed)
            place = np.arange(len(names)) + 0.27 * (group - 1) + 0.2 * (seed + 0.5) / seeds - 0.1
            psi, low, high = (np.clip(own[key].values, *_REACH) for key in ("psi", "low", "high"))
            axis.vlines(place, low, high, color=color, linewidth=1.2)
            axis.plot(place, psi, "o", color=color, markersize=2.5,
                      label=kind if seed == 0 else None)  # fmt: skip
    axis.axhline(1, color=INK, linewidth=0.6)
    axis.set(yscale="log", ylim=_REACH, ylabel="psi / truth", xticks=range(len(names)))
    axis.set_xticklabels([name.replace("_", "\n") for name in names])
    _plain(axis, (0.25, 0.5, 1, 2, 4))
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=3)


def _plain(axis: Axes, ticks: tuple[float, ...]) -> None:
    axis.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.minorticks_off()


DRAWING = Drawing(
    _draw,
    "Top left: error of the next state on held-out transitions of random policies over the number "
    "learned from, of the physical model with learned psi and of a network; lines: median over "
    "starts, bands: range; dashed: those that end in contact, dotted: nothing moves. Top right: "
    "the same at the full number, where transitions are exact, noisy, or of a hopper with a drag "
    "that the model lacks. Middle: mean of the random search's candidates, from one start; the "
    "second pass begins where psi moves again. Bottom: psi over its truth with 95 % intervals, all "
    "starts; what leaves the axis is cut at its edge.",
)
