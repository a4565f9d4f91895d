"""Figures of a curve over a parameter."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from reports.figures.run import FLOOR, label, time_panels
from reports.style import CYCLE, GREEN, GREY, INK, ORANGE, PLANNED, PURPLE, REPLAYED, WIDTH
from reports.view import RunView

_MOST_STATES = 6
_COLOURS = {"contact": GREEN, "fold": PURPLE, "switch": ORANGE}


def curve(view: RunView) -> Figure:
    """Cost and exact cost, complementarity, and iterations over the parameter, events marked."""
    points = view.run.meta["points"]
    value = _column(points, "value")
    good = np.array([bool(point["success"]) for point in points])
    figure = Figure(figsize=(WIDTH, 4.6))
    top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=(2, 1.3, 1))
    cost, exact = _column(points, "cost"), _column(points, "exact_cost")
    top.plot(value[good], cost[good], "o-", color=PLANNED, label="cost under the law")
    top.plot(value[good], exact[good], "s--", color=REPLAYED, label="cost under exact physics")
    top.set_ylabel("cost")
    shown = np.concatenate([cost[good], exact[good]])
    if shown.size and shown.min() > 0 and shown.max() > 20 * shown.min():
        top.set_yscale("log")
    complementarity = np.maximum(_column(points, "complementarity"), FLOOR)
    middle.semilogy(value[good], complementarity[good], "o-", color=CYCLE[2])
    middle.set_ylabel("max $\\lambda$ gap")
    bottom.plot(value, _column(points, "iterations"), "o", color=CYCLE[3])
    bottom.set_ylim(bottom=0)
    bottom.set_ylabel("iterations")
    bottom.set_xlabel(_parameter_label(view))
    for axis in (top, middle, bottom):
        for place in value[~good]:
            axis.axvline(place, color=INK, linestyle=":", linewidth=0.9)
        if view.run.meta["scale"] == "log":
            axis.set_xscale("log")
    _mark(figure, view.run.meta["events"])
    if not good.all():
        top.plot([], [], ":", color=INK, label="failed")
    figure.legend(loc="outside upper center", ncols=3)
    return figure


def states(view: RunView) -> Figure | None:
    """States of scenario 0 at a few points of the curve, the first faint, the last dark."""
    x = view.array("x")
    if x is None or not len(x):
        return None
    signals = view.signals("states")[:_MOST_STATES]
    figure, axes = time_panels(len(signals))
    values = view.run.data["value"].values
    chosen = np.unique(np.linspace(0, len(x) - 1, min(6, len(x))).round().astype(int))
    for axis, (index, signal) in zip(axes, enumerate(signals), strict=True):
        for strength, point in zip(np.linspace(0.25, 1, len(chosen)), chosen, strict=True):
            axis.plot(view.time, x[point, 0, :, index], color=PLANNED, alpha=strength,
                      label=f"{values[point]:.3g}" if index == 0 else None)  # fmt: skip
        axis.set_ylabel(label(signal.name, signal.unit))
    figure.legend(loc="outside upper center", ncols=6, title=_parameter_label(view))
    return figure


def _mark(figure: Figure, events: list[dict]) -> None:
    """A line at every event, numbered at the top as in the table; a tick where a bound is met."""
    top, number = figure.axes[0], 0
    for event in events:
        value = event["value"]
        if event["kind"] == "bound":
            top.axvline(value, ymax=0.06, color=GREY, linewidth=0.6)
            continue
        number += 1
        colour = _COLOURS[event["kind"]]
        for axis in figure.axes:
            axis.axvline(value, color=colour, linewidth=0.9, zorder=0.5)
        top.annotate(
            str(number), (value, 1), xycoords=("data", "axes fraction"), color=colour, fontsize=8,
            xytext=(0, 2 + 8 * (number % 2 == 0)), textcoords="offset points", ha="center",
        )  # fmt: skip


def _column(points: list[dict], name: str) -> np.ndarray:
    return np.array([np.nan if p[name] is None else p[name] for p in points], dtype=float)


def _parameter_label(view: RunView) -> str:
    return label(str(view.run.meta["over"]), str(view.run.meta.get("unit") or ""))
