"""Drawing of study N2."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from problems.registry import spec
from reports.figures.studies.panels import Drawing
from reports.strobe import draw_motion
from reports.style import BLUE, GREEN, GREY, INK, ORANGE, PURPLE, VERMILLION, WIDTH

_COLORS = {"f": GREY, "f_sigma": GREEN, "g_sigma": BLUE, "h": ORANGE, "h_sigma": VERMILLION}
_LABELS = {
    "f": "$f$", "f_sigma": r"$f_\sigma$", "g_sigma": r"$g_\sigma$", "h": "$h$",
    "h_sigma": r"$h_\sigma$",
}  # fmt: skip


def _draw(data: xr.Dataset) -> Figure:
    """Curves, strobes, heat maps and bars, two problems each."""
    figure = Figure(figsize=(WIDTH, 8.2), layout="constrained")
    parts: Any = figure.subfigures(4, 1, height_ratios=(2.2, 2.6, 1.7, 1.7))
    curves, strobes, maps, bars = parts
    names = [str(name) for name in data["problem"].values]
    for axis, name in zip(curves.subplots(1, 2), names, strict=True):
        _curves(axis, data.sel(problem=name))
        axis.set_title(name)
    curves.axes[0].set_ylabel("cost (14)")
    curves.legend(*curves.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=5)
    _strobes(strobes, data, names)
    _maps(maps, data, names)
    for axis, name in zip(bars.subplots(1, 2), names, strict=True):
        _costs(axis, data.sel(problem=name))
        axis.set_title(name)
    bars.axes[0].set_ylabel("cost of the object")
    bars.axes[0].legend(loc="upper center", ncols=3)
    return figure


def _curves(axis: Axes, data: xr.Dataset) -> None:
    step = data["step"].values
    for kind in data["dynamics"].values:
        color = _COLORS[str(kind)]
        found = data["learned"].sel(dynamics=kind)
        model, exact = (found.sel(end=end).values for end in data["end"].values)
        axis.plot(step, np.median(model, axis=0), color=color, linewidth=0.7)
        axis.fill_between(step, exact.min(axis=0), exact.max(axis=0), color=color, alpha=0.15,
                          linewidth=0)  # fmt: skip
        axis.plot(step, np.median(exact, axis=0), color=color, linewidth=1.8,
                  label=_LABELS[str(kind)])  # fmt: skip
        planned, replayed = data["gains"].sel(dynamics=kind).values
        axis.plot(1.05 * step[-1], planned, "o", color=color, markerfacecolor="white")
        axis.plot(1.05 * step[-1], replayed, "o", color=color)
    axis.set(yscale="log", xlabel="iteration of Adam", xlim=(step[0], 1.08 * step[-1]))


def _strobes(figure: SubFigure, data: xr.Dataset, names: list[str]) -> None:
    axes = figure.subplots(len(names), data.sizes["dynamics"])
    for row, name in zip(axes, names, strict=True):
        found = spec(name)
        assert found.draw is not None
        params, nx = found.params({}), found.problem().system.nx
        for axis, kind in zip(row, data["dynamics"].values, strict=True):
            states = data["states"].sel(problem=name, dynamics=kind).values[:, :nx]
            draw_motion(axis, [found.draw(params, state) for state in states])
            axis.set(xticks=[], yticks=[], title=_LABELS[str(kind)])
            axis.grid(False)
        row[0].set_ylabel(name)


def _maps(figure: SubFigure, data: xr.Dataset, names: list[str]) -> None:
    pairs = [(name, kind) for name in names for kind in data["swept"].values]
    for axis, (name, kind) in zip(figure.subplots(1, len(pairs)), pairs, strict=True):
        at = data.sel(problem=name)
        still = float(at["learned"].sel(dynamics="f", end="exact replay").isel(seed=0, step=0))
        ratio = at["final"].sel(swept=kind).values / still
        axis.imshow(np.log10(ratio), cmap="RdBu_r", vmin=-1.5, vmax=1.5, origin="lower",
                    aspect="auto")  # fmt: skip
        for i, j in np.ndindex(ratio.shape):
            strong = abs(np.log10(ratio[i, j])) > 0.9
            value = f"{ratio[i, j]:.2g}" if ratio[i, j] < 30 else ">30"
            axis.text(j, i, value, ha="center", va="center", fontsize=7,
                      color="white" if strong else INK)  # fmt: skip
        axis.set_xticks(range(ratio.shape[1]), [f"{n:.0e}".replace("e+0", "e")
                                                for n in data["amount"].values])  # fmt: skip
        axis.set_yticks(range(ratio.shape[0]), [f"{w:g}" for w in data["width"].values])
        axis.grid(False)
        axis.set(title=f"{name}, {_LABELS[str(kind)]}", xlabel="transitions")
    figure.axes[0].set_ylabel(r"width $\sigma$")


def _costs(axis: Axes, data: xr.Dataset) -> None:
    places, kinds = np.arange(data.sizes["law"]), data["of"].values
    for offset, kind, color in zip((-0.27, 0, 0.27), kinds, (GREY, BLUE, PURPLE), strict=True):
        values = data["cost"].sel(of=kind).values
        axis.bar(places + offset, values, 0.25, color=color, label=str(kind))
    axis.set(yscale="log", ylim=(1, 8 * float(data["cost"].max())))
    axis.set_xticks(places, [str(law) for law in data["law"].values])


DRAWING = Drawing(
    _draw,
    "Top: cost over Adam's iterations through each of the five dynamics, thin on the model, thick "
    "replayed under the exact law, medians over seeds and their range; circles at the right are "
    "gains by IPOPT, open on the model, full replayed. Then: what the last "
    "policies do under the exact law. Then: final exact cost of policies learned through the "
    "average of data and through the noised network, over the width of the noise and the amount "
    "of data, as a multiple of what standing still costs: less is blue, more is red. Bottom: the "
    "object's part of the cost of IPOPT's input sequences, at rest, as planned, and replayed.",
)
