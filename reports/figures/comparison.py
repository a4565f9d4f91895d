"""Figures that overlay motions and costs of several runs, or of points along a path."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from reports.drawing.notation import label, symbol
from reports.drawing.strobe import largest_size, strobe_rows
from reports.drawing.style import CYCLE, GREEN, GREY, INK, ORANGE, PLANNED, PURPLE, REPLAYED, WIDTH, line_of
from reports.drawing.view import RunView
from reports.figures.panels import Panel, Row, draw_lines, lay_out_rows, note_zero, use_log_if_wide
from reports.figures.run import FLOOR
from reports.figures.trajectories import Track, idle_multipliers, tracks
from reports.tables.console import number, small

_LETTERS = 45
"""Number of characters in a line of a run's name next to its costs."""
_LOG_RATIO = 30.0
"""Ratio of the largest to the smallest positive cost difference above which the scale is logarithmic."""


def comparison_rows(views: list[RunView]) -> list[list[str]]:
    """Return rows of a property and its value in each run; parts of the request are included only if they differ."""
    request_rows = [
        [key, *(str(view.run.record.get(key, "")) for view in views)]
        for key in ("problem", "contact", "method", "policy", "solver")
    ]
    table = [row for row in request_rows if len(set(row[1:])) > 1]
    runs = [view.run for view in views]
    table.append(["status", *(run.status.label for run in runs)])
    table.append(["referee", *(run.referee.word for run in runs)])
    table.append(["cost", *(number(run.meta["cost"], 7) for run in runs)])
    table.append(["exact cost", *(number(run.audit.exact_cost, 7) for run in runs)])
    table.append(["referee cost", *(number(run.referee.cost, 7) for run in runs)])
    for name, title in (
        ("complementarity", "largest λ gap"),
        ("dynamics_residual", "dynamics residual"),
        ("penetration", "penetration [m]"),
        ("state_gap", "plan to replay"),
    ):
        table.append([title, *(small(getattr(run.audit, name)) for run in runs)])
    table.append(["iterations", *(str(run.meta["iterations"]) for run in runs)])
    return table


def cost_figure(views: list[RunView], names: list[str]) -> Figure:
    """Draw the planned, replayed and refereed cost of each run, relative to the cheapest plan."""
    kinds = [
        ("planned", "o", PLANNED, [view.run.meta["cost"] for view in views]),
        ("replayed, exact law", "s", REPLAYED, [view.run.audit.exact_cost for view in views]),
        ("under the referee", "^", CYCLE[6], [view.run.referee.cost for view in views]),
    ]
    values = np.array([[np.nan if c is None else c for c in kind_costs] for *_, kind_costs in kinds], float)
    cheapest = float(np.nanmin(values[0]))
    excess = values - cheapest
    names = [fill(name, _LETTERS) for name in names]
    figure = Figure(figsize=(WIDTH, 0.65 + 0.2 * len(views) + 0.12 * "".join(names).count("\n")))
    axis = figure.subplots()
    positions = np.arange(len(views))
    for (text, mark, color, _), kind_costs in zip(kinds, excess, strict=True):
        axis.plot(kind_costs, positions, mark, color=color, label=text, markersize=4.5, alpha=0.85)
    finite = np.where(np.isfinite(excess), excess, 0.0)
    axis.hlines(positions, finite.min(axis=0), finite.max(axis=0), color=GREY, linewidth=0.8, zorder=0)
    positive = np.unique(excess[np.isfinite(excess) & (excess > 1e-9 * max(abs(cheapest), 1e-12))])
    if len(positive) > 1 and positive[-1] > _LOG_RATIO * positive[0]:
        axis.set_xscale("symlog", linthresh=10 ** np.floor(np.log10(positive[0])))
    axis.set_yticks(positions, names)
    axis.set_ylim(len(views) - 0.5, -0.5)
    axis.set_xlabel(f"cost beyond the cheapest plan, {number(cheapest, 7)}")
    axis.grid(visible=False, axis="y")
    figure.legend(loc="outside upper center", ncols=3)
    return figure


def same_instants(views: Sequence[RunView]) -> bool:
    """Return whether all runs have the same node times, so that differences can be drawn."""
    first = views[0].time
    return all(v.time.shape == first.shape and np.allclose(v.time, first) for v in views[1:])


def overlay_rows(views: list[RunView]) -> tuple[list[Row], list[str]]:
    """Return rows of panels of every state, input and multiplier of all runs, with differences from run A below.

    Multipliers that are always zero in every run are omitted; their names are also returned.
    """
    tracks_of_runs = [{(t.heading, t.name): t for t in tracks(view)} for view in views]
    idle_names = set.intersection(
        *(set(idle_multipliers(list(tracks_by_key.values()))) for tracks_by_key in tracks_of_runs)
    )
    all_tracks = {key: track for tracks_by_key in tracks_of_runs for key, track in tracks_by_key.items()}
    have_differences = same_instants(views) and len({view.scenarios for view in views}) == 1
    shown_keys = [key for key, track in all_tracks.items() if not (track.is_multiplier and key[1] in idle_names)]
    reach: dict[str, float] = {}
    for heading, name in shown_keys:
        members = [tracks_by_key[heading, name] for tracks_by_key in tracks_of_runs if (heading, name) in tracks_by_key]
        largest_difference = max(
            (largest_size(m.plan - members[0].plan) for m in members if have_differences), default=0.0
        )
        reach[heading] = max(reach.get(heading, 0.0), largest_difference)
    panels: dict[str, list[Panel]] = {}
    for heading, name in shown_keys:
        members_of_runs = [
            (index, tracks_by_key[heading, name])
            for index, tracks_by_key in enumerate(tracks_of_runs)
            if (heading, name) in tracks_by_key
        ]
        limit = reach[heading] if have_differences else None
        panels.setdefault(heading, []).append(_panel(members_of_runs, views, limit))
    return lay_out_rows(panels), sorted(idle_names)


def _panel(
    placed_tracks: Sequence[tuple[int, Track]], views: Sequence[RunView], largest_difference: float | None
) -> Panel:
    def main(axis: Axes) -> None:
        for index, track in placed_tracks:
            draw_lines(
                axis, views[index].time, track.plan, **line_of(index), linewidth=1.1 if len(track.plan) == 1 else 0.5
            )

    def below(axis: Axes) -> None:
        note_zero(axis)
        reference = placed_tracks[0][1].plan
        for index, track in placed_tracks[1:]:
            draw_lines(axis, views[index].time, track.plan - reference, **line_of(index), linewidth=0.9)
        limit = 1.1 * largest_difference if largest_difference else 1.0
        axis.set_ylim(-limit, limit)

    title = label(placed_tracks[0][1].name, placed_tracks[0][1].unit)
    return Panel(title, main, below if largest_difference is not None else None)


_EVENT_COLORS = {"contact": GREEN, "degenerate": GREEN, "fold": PURPLE, "switch": ORANGE}
"""Mapping from the kind of an event to its colour."""
_MAX_POINTS = 6
"""Maximum number of points of a path that are drawn."""


def curve_figure(view: RunView) -> Figure:
    """Draw costs, complementarity and iterations over the parameter, with events marked.

    Complementarity below :data:`~reports.figures.run.FLOOR` is not drawn; the panel is omitted if no value is
    above it.
    """
    points = view.run.meta["points"]
    value = _column(points, "value")
    succeeded = np.array([bool(point["success"]) for point in points])
    complementarity = np.where(succeeded, _column(points, "complementarity"), np.nan)
    is_visible = complementarity > FLOOR
    heights = (2, 1.2, 1) if is_visible.any() else (2, 1)
    figure = Figure(figsize=(WIDTH, 1.0 * sum(heights)))
    top, *middle, bottom = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights)
    _costs(top, points, value, succeeded)
    for axis in middle:
        # Under a barrier law all values equal mu up to rounding, so the axis would have no range.
        axis.set(yscale="log", ylabel="max λ gap")
        axis.set_ylim(complementarity[is_visible].min() / 3, complementarity[is_visible].max() * 3)
        axis.plot(value[is_visible], complementarity[is_visible], "o-", color=CYCLE[2])
    bottom.plot(value, _column(points, "iterations"), "o", color=CYCLE[3])
    bottom.set_ylim(bottom=0)
    bottom.set(ylabel="iterations", xlabel=parameter_label(view))
    for axis in figure.axes:
        for failed_value in value[~succeeded]:
            axis.axvline(failed_value, color=INK, linestyle=":", linewidth=0.9)
        if view.run.meta["scale"] == "log":
            axis.set_xscale("log")
    _mark(figure, view.run.meta["events"])
    if not succeeded.all():
        top.plot([], [], ":", color=INK, label="failed")
    figure.legend(loc="outside upper center", ncols=4)
    return figure


def _costs(axis: Axes, points: list[dict[str, Any]], value: np.ndarray, succeeded: np.ndarray) -> None:
    kinds = [
        ("cost", "o-", PLANNED, "under the law"),
        ("exact_cost", "s--", REPLAYED, "replayed, exact law"),
        ("referee_cost", "^:", CYCLE[6], "under the referee"),
    ]
    drawn_costs = []
    for name, style, color, text in kinds:
        if not all(name in point for point in points):
            continue
        cost = _column(points, name)
        if np.isfinite(cost[succeeded]).any():
            axis.plot(value[succeeded], cost[succeeded], style, color=color, label=text, markersize=3)
            drawn_costs.append(cost[succeeded])
    axis.set_ylabel("cost")
    use_log_if_wide(axis, np.concatenate(drawn_costs) if drawn_costs else np.zeros(0))


def chosen_points(view: RunView) -> list[int]:
    """Return the indices of the points of a path to draw, evenly spaced and including both ends."""
    count = view.run.data.sizes["point"]
    return sorted({int(i) for i in np.linspace(0, count - 1, min(_MAX_POINTS, count)).round()})


def strobe_figures(view: RunView, cones: bool = False) -> tuple[list[Figure], str]:
    """Return strobes at points along a path, with the parameter's value as title, and the caption of arrows."""
    if view.picture is None:
        return [], ""
    return strobe_rows([(title, view.at_point(point)) for point, title in _titled_points(view)], cones)


def _titled_points(view: RunView) -> list[tuple[int, str]]:
    values, unit = view.run.data["value"].values, str(view.run.meta.get("unit") or "")
    name = symbol(str(view.run.meta["over"]))
    value_unit = label("", unit).strip().strip("[]")
    return [(i, f"{name} = {number(values[i], 3)} {value_unit}".strip()) for i in chosen_points(view)]


def motion_rows(view: RunView) -> list[Row]:
    """Return panels of every state, input and multiplier, with curves from light to dark for points along the path."""
    if view.array("x") is None:
        return []
    shaded_views = [(view.at_point(point), color) for point, color in _shades(view)]
    tracks_of_points = [tracks(point_view) for point_view, _ in shaded_views]
    idle_names = (
        set.intersection(*(set(idle_multipliers(point_tracks)) for point_tracks in tracks_of_points))
        if tracks_of_points
        else set()
    )
    panels: dict[str, list[Panel]] = {}
    for index, track in enumerate(tracks_of_points[0]):
        if not (track.is_multiplier and track.name in idle_names):
            shaded_tracks = [
                (point_tracks[index], color)
                for point_tracks, (_, color) in zip(tracks_of_points, shaded_views, strict=True)
            ]
            panels.setdefault(track.heading, []).append(_point_panel(shaded_tracks, view.time))
    return lay_out_rows(panels)


def _point_panel(shaded_tracks: Sequence[tuple[Track, Any]], time: np.ndarray) -> Panel:
    def main(axis: Axes) -> None:
        for track, color in shaded_tracks:
            width = 1.0 if len(track.plan) == 1 else 0.5
            draw_lines(axis, time, track.plan, color=color, linewidth=width)

    return Panel(label(shaded_tracks[0][0].name, shaded_tracks[0][0].unit), main)


def _shades(view: RunView) -> list[tuple[int, Any]]:
    points = chosen_points(view)
    shades = mpl.colormaps["viridis_r"](np.linspace(0.12, 1, len(points)))
    return list(zip(points, shades, strict=True))


def point_key(view: RunView) -> Figure:
    """Draw the legend of the colours of points along the path, in one line."""
    handles = [
        Line2D([], [], color=color, label=title)
        for (_, color), (_, title) in zip(_shades(view), _titled_points(view), strict=True)
    ]
    figure = Figure(figsize=(WIDTH, 0.25))
    figure.set_layout_engine("none")
    figure.legend(
        handles=handles,
        loc="center left",
        ncols=len(handles),
        handlelength=1.2,
        columnspacing=1.2,
        fontsize=7.5,
        bbox_to_anchor=(0, 0.5),
    )
    return figure


def _mark(figure: Figure, events: list[dict]) -> None:
    """Draw a line at every event, numbered as in the table of events; for an active bound draw only a tick."""
    top, count = figure.axes[0], 0
    for event in events:
        value = event["value"]
        if event["kind"] == "bound":
            top.axvline(value, ymax=0.06, color=GREY, linewidth=0.6)
            continue
        count += 1
        colour = _EVENT_COLORS[event["kind"]]
        for axis in figure.axes:
            axis.axvline(value, color=colour, linewidth=0.9, zorder=0.5)
        top.annotate(
            str(count),
            (value, 1),
            xycoords=("data", "axes fraction"),
            color=colour,
            fontsize=8,
            xytext=(0, 2 + 8 * (count % 2 == 0)),
            textcoords="offset points",
            ha="center",
        )


def _column(points: list[dict], name: str) -> np.ndarray:
    return np.array([np.nan if p[name] is None else p[name] for p in points], dtype=float)


def parameter_label(view: RunView) -> str:
    """Return the label of the varied parameter, with its unit."""
    return label(symbol(str(view.run.meta["over"])), str(view.run.meta.get("unit") or ""))
