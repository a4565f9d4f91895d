"""Figures of closed loops: snapshots with the plan, accumulated cost, computing times, and contacts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from ocp.problem.problem import Problem
from reports.drawing.shapes import draw, show
from reports.drawing.style import BLUE, CYCLE, GREEN, GREY, INK, VERMILLION, WIDTH, line_of
from reports.drawing.view import RunView, plan_shapes
from reports.figures.panels import shade_spans
from reports.figures.run import contacts_of
from reports.tables.closed_loop import counted_times

_MAX_SNAPSHOTS = 4
"""Maximum number of snapshots of a closed loop."""
_BIN_EDGES = 40
"""Number of edges of the bins of a histogram."""
_TIMELINE = 12
"""Maximum number of contacts in a timeline."""


def snapshot_figure(view: RunView) -> Figure | None:
    """Draw seed 0 at a few samples, over the middle and end of each sample's plan; return None without a drawing."""
    picture = view.picture
    if picture is None:
        return None
    last = max(0, int(view.run.data["ended"].values[0]) - 1)
    chosen = np.unique(np.linspace(0, last, _MAX_SNAPSHOTS).round().astype(int))
    bodies = picture.shapes("", view.time[chosen])
    plan = view.array("plan")
    middle = 0 if plan is None else plan.shape[2] // 2
    # Back to front: the plan's middle and its end, then the body.
    frames = [
        [(plan_shapes(view, k, middle, body), 0.5), (plan_shapes(view, k, -1, body), 1.0), (body, 1.0)]
        for k, body in zip(chosen.tolist(), bodies, strict=True)
    ]
    all_shapes = [shape for frame in frames for shapes, _ in frame for shape in shapes]
    figure = Figure(figsize=(WIDTH, 2.0))
    axes = figure.subplots(1, len(chosen), squeeze=False)[0]
    for axis, k, frame in zip(axes, chosen, frames, strict=True):
        show(axis, all_shapes)
        for shapes, strength in frame:
            for shape in shapes:
                draw(shape, axis, strength)
        axis.set_title(f"{view.time[k]:.3g} s, sample {k}", loc="left")
        axis.set_xlabel(picture.axes[0], fontsize=7)
        axis.tick_params(labelsize=7)
        axis.label_outer()
    axes[0].set_ylabel(picture.axes[1], fontsize=7)
    ratio = np.ptp(axes[0].get_ylim()) / np.ptp(axes[0].get_xlim())
    figure.set_figheight(float(np.clip(ratio * WIDTH / len(chosen) + 0.5, 1.2, 3.2)))
    return figure


def cost_and_times(view: RunView) -> Figure:
    """Draw the accumulated cost of every seed, and a histogram of the time per sample."""
    figure = Figure(figsize=(WIDTH, 2.3))
    cost_axis, time_axis = figure.subplots(1, 2)
    for index, costs in enumerate(_accumulated_cost(view)):
        cost_axis.plot(view.time, costs, color=CYCLE[index % len(CYCLE)], linewidth=0.9)
    cost_axis.set(xlabel="time [s]", ylabel="cost so far")
    _histogram(time_axis, view)
    return figure


def _accumulated_cost(view: RunView) -> np.ndarray:
    """Return the sum of the stage costs before each node (S, T+1)."""
    cost = view.run.data["cost"].values
    return np.concatenate([np.zeros((len(cost), 1)), np.cumsum(cost, axis=1)], axis=1)


def _histogram(axis: Axes, view: RunView) -> None:
    times = view.run.meta["seconds"]
    seconds = 1e3 * counted_times(view.run.data["seconds"].values)
    if not seconds.size:
        return
    edges = np.geomspace(0.9 * seconds.min(), 1.1 * seconds.max(), _BIN_EDGES)
    axis.hist(seconds, edges.tolist(), color=BLUE, alpha=0.5)
    marks: tuple[tuple[str, str, Any], ...] = (
        ("p50", GREEN, "-"),
        ("p99", INK, "--"),
        ("max", GREY, ":"),
        ("period", VERMILLION, "-"),
    )
    for name, color, style in marks:
        if times[name] is not None:
            axis.axvline(
                1e3 * times[name],
                color=color,
                linestyle=style,
                linewidth=1.0,
                label=f"{name} {1e3 * times[name]:.3g} ms",
            )
    _of_milliseconds(axis)
    axis.set_ylabel("samples")
    missed = f"{times['over']} of {times['samples']} over the period"
    axis.set_title(f"{missed}; {view.run.meta['misses']} missed deadlines", loc="left", fontsize=8)
    axis.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    axis.legend(fontsize=7, frameon=True, framealpha=0.9, edgecolor="none")


def _of_milliseconds(axis: Axes) -> None:
    axis.set(xscale="log", xlabel="time of a sample [ms]")
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=9))
    axis.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.xaxis.set_minor_formatter(NullFormatter())


def contact_timeline(view: RunView) -> Figure | None:
    """Draw the steps at which each contact is active, a bar per seed; None without active contacts."""
    pairs = view.problem.system.pairs if isinstance(view.problem, Problem) else ()
    active_contacts = [
        (signal.name, contact.active)
        for i, (signal, contact) in enumerate(zip(view.signals("contacts"), contacts_of(view), strict=False))
        if contact.active.any() and (i >= len(pairs) or pairs[i].kind in ("normal", "limit"))
    ][:_TIMELINE]
    if not active_contacts:
        return None
    figure = Figure(figsize=(WIDTH, 0.55 + 0.3 * len(active_contacts)))
    axis = figure.subplots()
    for row, (_, active) in enumerate(active_contacts):
        bar_height = 0.8 / len(active)
        for seed, is_active in enumerate(active):
            low = row - 0.4 + seed * bar_height
            low, high = ((height + 0.5) / len(active_contacts) for height in (low, low + bar_height))
            color = CYCLE[seed % len(CYCLE)]
            shade_spans(axis, view.time, is_active, ymin=low, ymax=high, facecolor=color, linewidth=0)
    axis.set_yticks(range(len(active_contacts)), [name for name, _ in active_contacts])
    axis.set(ylim=(-0.5, len(active_contacts) - 0.5), xlim=(0, view.time[-1]), xlabel="time [s]")
    axis.grid(visible=False, axis="y")
    return figure


def comparison_figure(views: Sequence[RunView], names: Sequence[str]) -> Figure:
    """Draw the mean accumulated cost of each run with its range over seeds, and distributions of time per sample."""
    figure = Figure(figsize=(WIDTH, 2.6))
    cost_axis, time_axis = figure.subplots(1, 2)
    for index, (view, name) in enumerate(zip(views, names, strict=True)):
        style = line_of(index)
        costs = _accumulated_cost(view)
        costs = costs[np.isfinite(costs).all(axis=1)]
        if len(costs):
            cost_axis.plot(view.time, costs.mean(axis=0), label=name, **style)
            cost_axis.fill_between(
                view.time, costs.min(axis=0), costs.max(axis=0), alpha=0.15, color=style["color"], linewidth=0
            )
        seconds = np.sort(1e3 * counted_times(view.run.data["seconds"].values))
        time_axis.step(seconds, (1 + np.arange(len(seconds))) / max(1, len(seconds)), **style)
    cost_axis.set(xlabel="time [s]", ylabel="cost so far")
    _of_milliseconds(time_axis)
    time_axis.set_ylabel("share of samples")
    figure.legend(loc="outside upper center", ncols=min(6, len(views)))
    return figure
