"""Several runs side by side."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from reports.console import number, small
from reports.figures.run import label, time_panels
from reports.strobe import draw_strobe
from reports.style import CYCLE, PLANNED, REPLAYED, WIDTH
from reports.view import RunView

_MOST_PANELS = 12
_MOST_STROBES = 6


def rows(views: list[RunView]) -> list[list[str]]:
    """Table of the comparison: one row a property, one column a run."""
    found = [
        [key, *(str(view.run.record.get(key, "")) for view in views)]
        for key in ("problem", "contact", "method", "policy", "solver")
    ]
    runs = [view.run for view in views]
    found.append(["status", *(run.status.label for run in runs)])
    found.append(["cost", *(number(run.meta["cost"], 7) for run in runs)])
    found.append(["exact cost", *(number(run.audit.exact_cost, 7) for run in runs)])
    for name, title in (
        ("complementarity", "largest λ·gap"),
        ("dynamics_residual", "dynamics residual"),
        ("penetration", "penetration [m]"),
        ("state_gap", "plan to replay"),
    ):
        found.append([title, *(small(getattr(run.audit, name)) for run in runs)])
    found.append(["iterations", *(str(run.meta["iterations"]) for run in runs)])
    return found


def costs(views: list[RunView], names: list[str]) -> Figure:
    """Planned and exact cost of each run."""
    figure = Figure(figsize=(WIDTH, 1.9))
    axis = figure.subplots()
    place = np.arange(len(views))
    planned = np.array([view.run.meta["cost"] for view in views], dtype=float)
    exact = [view.run.audit.exact_cost for view in views]
    axis.bar(place - 0.2, planned, 0.38, color=PLANNED, label="planned")
    axis.bar(place + 0.2, exact, 0.38, color=REPLAYED, label="under exact physics", hatch="//",
             edgecolor="white")  # fmt: skip
    titles = [f"{name}: {view.run.record.get('contact', '')}" for name, view in
              zip(names, views, strict=True)]  # fmt: skip
    axis.set_xticks(place, titles)
    axis.set_ylabel("cost")
    axis.grid(visible=False, axis="x")
    figure.legend(loc="outside upper center", ncols=2)
    return figure


def overlay(views: list[RunView], names: list[str]) -> Figure:
    """States and inputs of all runs over time, scenario 0; plans solid, replays dashed."""
    panels = [("x", "states", i, s) for i, s in enumerate(views[0].signals("states"))]
    panels += [("u", "inputs", i, s) for i, s in enumerate(views[0].signals("inputs"))]
    panels = panels[:_MOST_PANELS]
    figure, axes = time_panels(len(panels))
    for axis, (name, _, index, signal) in zip(axes, panels, strict=True):
        for number_of_run, view in enumerate(views):
            color = CYCLE[number_of_run % len(CYCLE)]
            for stored, style in ((name, "-"), (f"{name}_replay", "--")):
                values = view.array(stored)
                if values is not None:
                    axis.plot(view.time[: values.shape[1]], values[0, :, index], style,
                              color=color, linewidth=1.3 if style == "-" else 0.8)  # fmt: skip
        axis.set_ylabel(label(signal.name, signal.unit))
    handles = [
        Line2D([], [], color=CYCLE[i % len(CYCLE)], label=name) for i, name in enumerate(names)
    ]
    handles.append(Line2D([], [], color="black", linestyle="--", linewidth=0.8, label="replayed"))
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles))
    return figure


def strobes(views: list[RunView], names: list[str]) -> Figure | None:
    """The motions beside each other."""
    shown = [
        (name, view)
        for name, view in zip(names, views, strict=True)
        if view.spec is not None and view.spec.draw is not None
    ][:_MOST_STROBES]
    if not shown:
        return None
    count = -(-len(shown) // 2)
    figure = Figure(figsize=(WIDTH, 2.6 * count))
    axes = figure.subplots(count, 2, squeeze=False).ravel()
    for axis, (name, view) in zip(axes, shown, strict=False):
        draw_strobe(axis, view)
        axis.set_title(f"{name}: {view.run.record.get('contact', '')}", loc="left")
    for axis in axes[len(shown) :]:
        axis.set_axis_off()
    return figure
