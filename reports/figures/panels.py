"""Small multiples: rows of panels of equal size; pages can break between rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator

from reports.drawing.style import GREY, INK, WIDTH

PANEL_COLUMNS = 4
"""Number of panels side by side across a page."""
_LEFT_IN = 0.40
"""Space on the left of a panel for its ticks [inch]."""
_RIGHT_IN = 0.08
"""Space on the right of a panel [inch]."""
_HEADING_IN = 0.2
"""Height of the heading of a group [inch]."""
_TITLE_IN = 0.17
"""Height of the title of a panel [inch]."""
_PANEL_IN = 0.78
"""Height of a panel [inch]."""
_BETWEEN_IN = 0.07
"""Space between a panel and its strip [inch]."""
_FOOT_IN = 0.34
"""Height of the ticks and labels below a panel [inch]."""
_LONG = 20
"""Maximum number of characters of a title that fit over a panel."""

Drawing = Callable[[Axes], None]


@dataclass(frozen=True)
class Panel:
    """One small picture: its title with unit, a function that draws it, and a function that draws a strip below it."""

    title: str
    main: Drawing
    below: Drawing | None = None


@dataclass(frozen=True)
class Cell:
    """Panel with its column; the first panel of a group in a row has the group's title as ``heading``, others ""."""

    column: int
    heading: str
    panel: Panel


Row = list[Cell]


def lay_out_rows(groups: Mapping[str, Sequence[Panel]], columns: int = PANEL_COLUMNS) -> list[Row]:
    """Return the rows of a layout of ``groups``, which maps headings to panels.

    A group begins in the last row of the previous group if that saves a row, else in a new row. Its heading is
    repeated in each of its rows, since a page may end between rows.
    """
    rows: list[Row] = []
    for heading, panels in groups.items():
        free_places = columns - len(rows[-1]) if rows else 0
        if -(-max(len(panels) - free_places, 0) // columns) >= -(-len(panels) // columns):
            rows.append([])
        for index, panel in enumerate(panels):
            if len(rows[-1]) == columns:
                rows.append([])
            goes_on = bool(index and rows[-1])
            rows[-1].append(Cell(len(rows[-1]), "" if goes_on else heading, panel))
    return [row for row in rows if row]


def columns_for(count: int) -> int:
    """Return the number of columns for which ``count`` panels leave the fewest empty places."""
    return {1: 1, 2: 2, 3: 3, 5: 3, 6: 3, 9: 3}.get(count, PANEL_COLUMNS)


def draw_rows(
    rows: Sequence[Row], columns: int = PANEL_COLUMNS, below: float = 0.34, label: str = "time [s]"
) -> Figure:
    """Draw rows of panels one below the other, placed in inches so that several figures align.

    ``below`` is the height [inch] of the strips below panels.
    """
    heights = [_row_height(row, below) for row in rows]
    figure = Figure(figsize=(WIDTH, sum(heights)))
    figure.set_layout_engine("none")
    top = sum(heights)
    for row, height in zip(rows, heights, strict=True):
        _draw_row(figure, row, top, (columns, below), label)
        top -= height
    return figure


def _row_height(row: Row, below: float) -> float:
    heading = _HEADING_IN if any(cell.heading for cell in row) else 0.0
    strip = below + _BETWEEN_IN if any(cell.panel.below for cell in row) else 0.0
    return heading + _TITLE_IN + _PANEL_IN + strip + _FOOT_IN


def _draw_row(figure: Figure, row: Row, top: float, shape: tuple[int, float], label: str) -> None:
    (columns, below), (width, height) = shape, figure.get_size_inches()
    cell_width = width / columns

    def add_axes(column: int, high: float, tall: float) -> Axes:
        x_low = column * cell_width + _LEFT_IN
        panel_width = cell_width - _LEFT_IN - _RIGHT_IN
        return figure.add_axes((x_low / width, (high - tall) / height, panel_width / width, tall / height))

    if any(cell.heading for cell in row):
        for cell in row:
            place_x, place_y = cell.column * cell_width + 0.06, top - 0.03
            figure.text(
                place_x / width, place_y / height, cell.heading, fontsize=8.5, fontweight="bold", color=INK, va="top"
            )
        top -= _HEADING_IN
    top -= _TITLE_IN
    for cell in row:
        axis = add_axes(cell.column, top, _PANEL_IN)
        cell.panel.main(axis)
        _dress(axis, 4)
        axis.set_title(
            cell.panel.title,
            loc="left",
            pad=2.5,
            x=-0.1 * columns / (width - 0.5),
            fontsize=8 if len(cell.panel.title) <= _LONG else 7,
        )
        if cell.panel.below is not None:
            axis.tick_params(labelbottom=False)
            strip = add_axes(cell.column, top - _PANEL_IN - _BETWEEN_IN, below)
            strip.sharex(axis)
            cell.panel.below(strip)
            _dress(strip, 2)
            axis = strip
        axis.set_xlabel(label, fontsize=7, labelpad=1)


def _dress(axis: Axes, ticks: int) -> None:
    """Set few ticks with short numbers, and widen the range of a nearly constant signal."""
    _widen(axis)
    axis.tick_params(labelsize=7, pad=1.5, length=2)
    if axis.get_yscale() == "linear":
        axis.yaxis.set_major_locator(MaxNLocator(ticks, min_n_ticks=2))
        axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.4g}"))
    if axis.get_xscale() == "linear":
        axis.xaxis.set_major_locator(MaxNLocator(4))


def _widen(axis: Axes) -> None:
    low, high = axis.get_ylim()
    middle = (low + high) / 2
    if axis.get_yscale() == "linear" and high - low < 1e-4 * abs(middle):
        half_height = 0.05 * abs(middle)
        axis.set_ylim(middle - half_height, middle + half_height)


def draw_lines(axis: Axes, time: np.ndarray, values: np.ndarray, **style: Any) -> None:
    """Draw values (S, N+1) at the nodes of ``time`` (N+1,), or (S, N) held over its steps."""
    for scenario in np.atleast_2d(values):
        if scenario.size < time.size:
            axis.step(time, np.append(scenario, scenario[-1]), where="post", **style)
        else:
            axis.plot(time, scenario, **style)


def fill_band(axis: Axes, time: np.ndarray, low: np.ndarray, high: np.ndarray, **style: Any) -> None:
    """Fill the band from ``low`` to ``high``, each (N+1,) at the nodes or (N,) held over steps."""
    if low.size < time.size:
        low, high = np.append(low, low[-1]), np.append(high, high[-1])
        axis.fill_between(time, low, high, step="post", linewidth=0, **style)
    else:
        axis.fill_between(time, low, high, linewidth=0, **style)


def shade_spans(axis: Axes, time: np.ndarray, is_shaded: np.ndarray, **style: Any) -> None:
    """Shade the steps at which ``is_shaded`` (N,) is true; adjacent steps are one patch, without a seam."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(is_shaded, dtype=int), [0]])))
    for first, stop in zip(edges[::2], edges[1::2], strict=True):
        axis.axvspan(float(time[first]), float(time[stop]), **style)


def note_zero(axis: Axes) -> None:
    """Draw a horizontal line at zero."""
    axis.axhline(0, color=GREY, linewidth=0.6)


def use_log_if_wide(axis: Axes, values: np.ndarray) -> None:
    """Set a log scale if all finite values are positive and the largest is over 20 times the smallest."""
    finite = values[np.isfinite(values)]
    if finite.size and finite.min() > 0 and finite.max() > 20 * finite.min():
        axis.set_yscale("log")
