"""Figures of a path over a parameter: its costs, its motions, and everything over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from reports.console import number
from reports.figures.motion import Track, idle, tracks
from reports.figures.panels import Panel, Row, in_rows, lines
from reports.figures.run import FLOOR
from reports.notation import label, symbol
from reports.strobe import strobe_rows
from reports.style import CYCLE, GREEN, GREY, INK, ORANGE, PLANNED, PURPLE, REPLAYED, WIDTH
from reports.view import RunView

_COLOURS = {"contact": GREEN, "degenerate": GREEN, "fold": PURPLE, "switch": ORANGE}
_PICTURES = 6


def curve(view: RunView) -> Figure:
    """Cost and exact cost, complementarity, and iterations over the parameter, events marked.

    Complementarity below what is told from zero is not drawn, and has no panel where all is.
    """
    points = view.run.meta["points"]
    value = _column(points, "value")
    good = np.array([bool(point["success"]) for point in points])
    complementarity = np.where(good, _column(points, "complementarity"), np.nan)
    seen = complementarity > FLOOR
    heights = (2, 1.2, 1) if seen.any() else (2, 1)
    figure = Figure(figsize=(WIDTH, 1.0 * sum(heights)))
    top, *middle, bottom = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    _costs(top, points, value, good)
    for axis in middle:
        # Under a barrier law all equal mu up to rounding, which gives an axis no range.
        axis.set(yscale="log", ylabel="max λ gap")
        axis.set_ylim(complementarity[seen].min() / 3, complementarity[seen].max() * 3)
        axis.plot(value[seen], complementarity[seen], "o-", color=CYCLE[2])
    bottom.plot(value, _column(points, "iterations"), "o", color=CYCLE[3])
    bottom.set_ylim(bottom=0)
    bottom.set(ylabel="iterations", xlabel=parameter_label(view))
    for axis in figure.axes:
        for place in value[~good]:
            axis.axvline(place, color=INK, linestyle=":", linewidth=0.9)
        if view.run.meta["scale"] == "log":
            axis.set_xscale("log")
    _mark(figure, view.run.meta["events"])
    if not good.all():
        top.plot([], [], ":", color=INK, label="failed")
    figure.legend(loc="outside upper center", ncols=4)
    return figure


def _costs(axis: Axes, points: list[dict[str, Any]], value: np.ndarray, good: np.ndarray) -> None:
    kinds = [
        ("cost", "o-", PLANNED, "under the law"),
        ("exact_cost", "s--", REPLAYED, "replayed, exact law"),
        ("referee_cost", "^:", CYCLE[6], "under the referee"),
    ]
    drawn = []
    for name, style, color, text in kinds:
        if not all(name in point for point in points):
            continue
        cost = _column(points, name)
        if np.isfinite(cost[good]).any():
            axis.plot(value[good], cost[good], style, color=color, label=text, markersize=3)
            drawn.append(cost[good])
    axis.set_ylabel("cost")
    shown = np.concatenate(drawn) if drawn else np.zeros(0)
    shown = shown[np.isfinite(shown)]
    if shown.size and shown.min() > 0 and shown.max() > 20 * shown.min():
        axis.set_yscale("log")


def chosen_points(view: RunView) -> list[int]:
    """Points of the path that are pictured, evenly apart in their order, both ends among them."""
    count = view.run.data.sizes["point"]
    return sorted({int(i) for i in np.linspace(0, count - 1, min(_PICTURES, count)).round()})


def strobes(view: RunView, cones: bool = False) -> tuple[list[Figure], str]:
    """The motion at points along the path, each beside its value, and what the arrows mean."""
    if view.picture is None:
        return [], ""
    return strobe_rows([(told, view.at_point(point)) for point, told in _named(view)], cones)


def _named(view: RunView) -> list[tuple[int, str]]:
    values, unit = view.run.data["value"].values, str(view.run.meta.get("unit") or "")
    name = symbol(str(view.run.meta["over"]))
    told = label("", unit).strip().strip("[]")
    return [(i, f"{name} = {number(values[i], 3)} {told}".strip()) for i in chosen_points(view)]


def motion_rows(view: RunView) -> list[Row]:
    """Every state, input and multiplier over time at points along the path, light to dark."""
    if view.array("x") is None:
        return []
    found = [(view.at_point(point), color) for point, color in _shades(view)]
    whole = [tracks(at) for at, _ in found]
    resting = set.intersection(*(set(idle(each)) for each in whole)) if whole else set()
    panels: dict[str, list[Panel]] = {}
    for index, track in enumerate(whole[0]):
        if not (track.multiplier and track.name in resting):
            own = [(each[index], color) for each, (_, color) in zip(whole, found, strict=True)]
            panels.setdefault(track.heading, []).append(_panel(own, view.time))
    return in_rows(panels)


def _panel(shown: Sequence[tuple[Track, Any]], time: np.ndarray) -> Panel:
    def main(axis: Axes) -> None:
        for track, color in shown:
            width = 1.0 if len(track.plan) == 1 else 0.5
            lines(axis, time, track.plan, color=color, linewidth=width)

    return Panel(label(shown[0][0].name, shown[0][0].unit), main)


def _shades(view: RunView) -> list[tuple[int, Any]]:
    points = chosen_points(view)
    shades = mpl.colormaps["viridis_r"](np.linspace(0.12, 1, len(points)))
    return list(zip(points, shades, strict=True))


def key(view: RunView) -> Figure:
    """Which colour is which point of the path, in one line."""
    handles = [
        Line2D([], [], color=color, label=told)
        for (_, color), (_, told) in zip(_shades(view), _named(view), strict=True)
    ]
    figure = Figure(figsize=(WIDTH, 0.25))
    figure.set_layout_engine("none")
    figure.legend(handles=handles, loc="center left", ncols=len(handles), handlelength=1.2,
                  columnspacing=1.2, fontsize=7.5, bbox_to_anchor=(0, 0.5))  # fmt: skip
    return figure


def _mark(figure: Figure, events: list[dict]) -> None:
    """A line at every event, numbered at the top as in the table; a tick where a bound is met."""
    top, count = figure.axes[0], 0
    for event in events:
        value = event["value"]
        if event["kind"] == "bound":
            top.axvline(value, ymax=0.06, color=GREY, linewidth=0.6)
            continue
        count += 1
        colour = _COLOURS[event["kind"]]
        for axis in figure.axes:
            axis.axvline(value, color=colour, linewidth=0.9, zorder=0.5)
        top.annotate(
            str(count), (value, 1), xycoords=("data", "axes fraction"), color=colour, fontsize=8,
            xytext=(0, 2 + 8 * (count % 2 == 0)), textcoords="offset points", ha="center",
        )  # fmt: skip


def _column(points: list[dict], name: str) -> np.ndarray:
    return np.array([np.nan if p[name] is None else p[name] for p in points], dtype=float)


def parameter_label(view: RunView) -> str:
    """The swept parameter with its unit."""
    return label(symbol(str(view.run.meta["over"])), str(view.run.meta.get("unit") or ""))
