"""Figures for papers: without a page, lettered, one or two columns wide, with embedded fonts."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from string import ascii_lowercase
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.transforms import Bbox

from ocp.errors import InputError, choose
from ocp.store.stored_run import StoredRun
from problems.spec import ProblemSpec
from reports.drawing.notation import label
from reports.drawing.strobe import acting_contacts, draw_strobe, forces_of
from reports.drawing.style import CYCLE, INK, WIDTH, house_style, show_literally
from reports.drawing.view import RunView
from reports.figures.studies import DRAWINGS

_PANEL_COLUMNS = 3
"""Number of panels side by side."""
_ROW_IN = 1.75
"""Height of a row of panels [inch]."""
_STROBE_TALLEST_IN = 3.0
"""Maximum height of a strobe [inch]."""
_LINE_STYLES = ("-", (0, (4, 2)))
"""Line styles of planned and replayed signals."""
_CONSTANT_CHANGE = 1e-6
"""Relative change of signals below which they are drawn as constant."""
_LEGEND_LINE_SHARE = 0.17
"""Height of a line of the legend, as a fraction of the height of the curves."""


@dataclass(frozen=True)
class SignalGroup:
    """Signals with the same unit: k names, planned values (S, N+1 or N, k), and replayed values or None."""

    title: str
    names: list[str]
    planned: np.ndarray
    replayed: np.ndarray | None


def solution_figure(view: RunView) -> Figure:
    """Draw a solved run: the strobe, and a panel for each unit of states, inputs and forces.

    Solid lines are planned signals, dashed lines are replayed under the exact law.

    Raises :class:`~ocp.errors.InputError` for a run of another kind.
    """
    view.run.check_solve()
    signal_groups = group_signals(view)
    rows = -(-len(signal_groups) // _PANEL_COLUMNS)
    has_picture = view.picture is not None
    figure = Figure(figsize=(WIDTH, _ROW_IN * rows + 0.4))
    grid = figure.add_gridspec(rows + has_picture, min(_PANEL_COLUMNS, len(signal_groups)))
    if has_picture:
        strobe = figure.add_subplot(grid[0, :])
        draw_strobe(strobe, view)
        ratio = float(np.ptp(strobe.get_ylim()) / np.ptp(strobe.get_xlim()))
        height = float(np.clip(0.9 * WIDTH * ratio + 0.6, 1.4, _STROBE_TALLEST_IN))
        grid.set_height_ratios([height, *[_ROW_IN] * rows])
        figure.set_figheight(height + _ROW_IN * rows + 0.4)
    for index, group in enumerate(signal_groups):
        row, column = divmod(index, _PANEL_COLUMNS)
        _draw(figure.add_subplot(grid[row + has_picture, column]), view.time, group)
    if any(group.replayed is not None for group in signal_groups):
        law = view.run.record.get("contact", "chosen")
        texts = f"planned under the {law} law", "replayed under the exact law"
        handles = [
            Line2D([], [], color=INK, linestyle=dash, label=text)
            for dash, text in zip(_LINE_STYLES, texts, strict=True)
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


def group_signals(view: RunView) -> list[SignalGroup]:
    """Return states and inputs grouped by unit, in the system's order, then the forces of acting contacts."""
    signal_groups = []
    for kind, name in (("states", "x"), ("inputs", "u")):
        values, replayed_array = view.array(name), view.array(f"{name}_replay")
        if values is None:
            continue
        signals = view.signals(kind)
        for unit in dict.fromkeys(signal.unit for signal in signals):
            unit_indices = [i for i, signal in enumerate(signals) if signal.unit == unit]
            replayed = None if replayed_array is None else replayed_array[..., unit_indices]
            names = [signals[i].name for i in unit_indices]
            signal_groups.append(SignalGroup(label(kind, unit), names, values[..., unit_indices], replayed))
    pushed = _pushed(view)
    return signal_groups if pushed is None else [*signal_groups, pushed]


def _pushed(view: RunView) -> SignalGroup | None:
    """Return the magnitudes of the forces of acting contacts in scenario 0; None if no contact acts."""
    forces, (sizes, acting) = forces_of(view), acting_contacts(view)
    if forces is None or not acting:
        return None
    planned, *replayed = (size[None][..., [*acting]] for size in sizes.values())
    noun = "impulses" if forces.unit == "N s" else "contact forces"
    return SignalGroup(label(noun, forces.unit), [*acting.values()], planned, *(replayed or [None]))


def _draw(axis: Axes, time: np.ndarray, group: SignalGroup) -> None:
    for values, dash in zip((group.planned, group.replayed), _LINE_STYLES, strict=True):
        if values is None:
            continue
        style = {"linestyle": dash, "linewidth": 1.1 if len(values) == 1 else 0.6}
        for i, name in enumerate(group.names):
            for scenario, line in enumerate(values[..., i]):
                # The first six colours are distinct in grey print; later lines also have marks.
                mark = {"marker": "so^D"[i // 6 % 4], "markevery": 5 + i % 6} if i >= 6 else {}
                color = CYCLE[i % len(CYCLE)]
                line_label = name if dash == _LINE_STYLES[0] and scenario == 0 else None
                if line.size < time.size:
                    axis.stairs(line, time, baseline=None, color=color, label=line_label, **style)
                else:
                    axis.plot(time, line, color=color, label=line_label, **style, **mark)
    low, high = axis.get_ylim()
    if high - low < _CONSTANT_CHANGE * max(abs(low), abs(high)):
        half_height = 0.05 * max(abs(low), abs(high))
        low, high = low - half_height, high + half_height
    columns = 1 + len(group.names) // 4
    rows = -(-len(group.names) // columns)
    # The legend has a space of its own above the lines.
    axis.set_ylim(low, high + _LEGEND_LINE_SHARE * rows * (high - low))
    axis.set_title(group.title, loc="left")
    axis.set_xlabel("time [s]")
    axis.legend(
        fontsize=7,
        ncols=columns,
        handlelength=1.0,
        columnspacing=0.8,
        labelspacing=0.2,
        borderaxespad=0.2,
        loc="upper left",
    )


COLUMN_IN = 3.5
"""Width of a column in two-column journals [inch]."""
BOTH_COLUMNS_IN = 7.16
"""Width of both columns including the gap between them [inch]."""
_RASTER_DPI = 300
"""Dots per inch of bitmaps."""
_PADDING_IN = 0.02
"""White space around a single panel [inch]."""
_TALLEST = 0.85
"""Maximum ratio of height to width of a single panel."""
_WIDE_PANEL = 0.55
"""Fraction of the figure's width above which a single panel is two columns wide."""
_ALIGNED = 5e-3
"""Distance of edges, as a fraction of the figure, up to which axes count as aligned."""
_LAYOUT_ROUNDS = 4
"""Number of rounds of resizing, after which the layout no longer changes."""
# Type 42 embeds whole TrueType fonts; publishers reject Type 3.
_SETTINGS: dict[Any, Any] = {"pdf.fonttype": 42}
FORMATS: dict[str, dict[str, None]] = {
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "svg": {"Date": None, "Creator": None},
    "png": {"Software": None},
}
"""Mapping from the formats of figures to the metadata that are omitted from each format."""


def format_of(file: Path) -> str:
    """Return the format of a file from its suffix; raises InputError for an unknown suffix."""
    ending = file.suffix.removeprefix(".")
    if ending not in FORMATS:
        raise InputError(
            f"a figure must end in .pdf, .svg or .png, got {file.suffix!r}; use"
            f" {file.with_suffix('.pdf').name}, for example"
        )
    return ending


def bare_figure(run: StoredRun, ending: str, panel: str | None = None, file_spec: ProblemSpec | None = None) -> bytes:
    """Return the figure of a stored study or solve, or only its panel ``"a"``, ``"b"``, ..., as bytes of a file.

    ``file_spec`` is the problem of a user's file. Raises :class:`~ocp.errors.InputError` for a run of another
    kind, and if :func:`render_figure` does.
    """
    with house_style():
        if run.kind == "figure":
            figure = DRAWINGS[run.meta["problem"]].draw(run.data)
        else:
            figure = show_literally(solution_figure(RunView.of(run, file_spec)))
        return render_figure(figure, ending, panel)


def render_figure(figure: Figure, ending: str, panel: str | None = None) -> bytes:
    """Return a drawn figure, or one of its panels, as bytes of a file; the bytes are always the same.

    A figure of several panels is two columns wide, and each panel has its letter; a single panel is one column
    wide. ``figure`` is changed, and must not be used again.

    Raises :class:`~ocp.errors.InputError` for an unknown ``ending`` or panel.
    """
    choose("format", ending, FORMATS)
    shown_axes = panel_axes(figure)
    box = None
    if panel is not None:
        letters = ascii_lowercase[: len(shown_axes)]
        if len(panel) != 1 or panel not in letters:
            letters_text = f"a to {letters[-1]}" if len(letters) > 1 else "only a"
            raise InputError(f"unknown panel {panel!r}; the figure has {letters_text}")
        box = _isolate_panel(figure, shown_axes[letters.index(panel)])
    else:
        width, height = figure.get_size_inches()
        if len(shown_axes) > 1:
            for letter, axis in zip(ascii_lowercase, shown_axes, strict=False):
                title_side = "center" if axis.get_title("center") else "left"
                axis.set_title(f"({letter}) {axis.get_title(title_side)}".rstrip(), loc=title_side)
            figure.set_size_inches(BOTH_COLUMNS_IN, height)
        else:
            figure.set_size_inches(COLUMN_IN, height * COLUMN_IN / width)
    buffer = io.BytesIO()
    with mpl.rc_context(_SETTINGS):
        figure.savefig(buffer, format=ending, dpi=_RASTER_DPI, bbox_inches=box, metadata=FORMATS[ending])
    return buffer.getvalue()


def panel_axes(figure: Figure) -> list[Axes]:
    """Return the axes that have content, in the order of their layout."""
    return [axis for axis in figure.axes if axis.axison or axis.has_data() or axis.get_title()]


def _isolate_panel(figure: Figure, axis: Axes) -> Bbox:
    """Hide all axes except ``axis``, make it as wide as a column, and return the box that it covers [inch].

    A panel wider than the fraction :data:`_WIDE_PANEL` is made two columns wide.
    """
    canvas, key = FigureCanvasAgg(figure), _lend_key(axis)
    figure.draw_without_rendering()
    target_width = BOTH_COLUMNS_IN if axis.bbox.width > _WIDE_PANEL * figure.bbox.width else COLUMN_IN
    for source_axis in figure.axes:
        if source_axis is not axis:
            _lend_labels(source_axis, axis)
            source_axis.set_visible(False)
    # Fonts keep their size when the figure is resized, so the layout settles only after a few rounds.
    for _ in range(_LAYOUT_ROUNDS):
        figure.draw_without_rendering()
        if key is not None:
            _put_below(key, axis, canvas)
        covered = _covered(axis, canvas)
        width_in, height_in = figure.get_size_inches()
        growth = (target_width - 2 * _PADDING_IN) * figure.dpi / covered.width
        height = covered.height / figure.dpi
        figure.set_size_inches(width_in * growth, height_in * min(growth, _TALLEST * target_width / height))
    figure.draw_without_rendering()
    if key is not None:
        _put_below(key, axis, canvas)
    inches = figure.dpi_scale_trans.inverted()
    return _covered(axis, canvas).transformed(inches).padded(_PADDING_IN)


def _covered(axis: Axes, canvas: FigureCanvasAgg) -> Bbox:
    """Return the box [pixel] that an axis with its labels and legend covers."""
    covered = axis.get_tightbbox(canvas.get_renderer())
    assert covered is not None
    return covered


def _lend_labels(source_axis: Axes, axis: Axes) -> None:
    """Copy from ``source_axis`` the labels that ``axis`` lacks, if the two are aligned and have the same limits."""
    axis_box, other_box = axis.get_position(), source_axis.get_position()
    if axis.get_shared_x_axes().joined(axis, source_axis) or (
        np.allclose((axis_box.x0, axis_box.x1), (other_box.x0, other_box.x1), atol=_ALIGNED)
        and np.array_equal(axis.get_xlim(), source_axis.get_xlim())
    ):
        axis.set_xlabel(axis.get_xlabel() or source_axis.get_xlabel())
    if axis.get_shared_y_axes().joined(axis, source_axis) or (
        np.allclose((axis_box.y0, axis_box.y1), (other_box.y0, other_box.y1), atol=_ALIGNED)
        and np.array_equal(axis.get_ylim(), source_axis.get_ylim())
    ):
        axis.set_ylabel(axis.get_ylabel() or source_axis.get_ylabel())
    if axis.get_shared_x_axes().joined(axis, source_axis):
        axis.tick_params(labelbottom=True)
    if axis.get_shared_y_axes().joined(axis, source_axis):
        axis.tick_params(labelleft=True)


def _lend_key(axis: Axes) -> Legend | None:
    """Copy the figure's legend to an axis, in addition to its own, and return it; None if the figure has none."""
    root = axis.get_figure(root=True)
    assert root is not None
    own_part = axis.get_figure(root=False)
    lent_legend = None
    for subfigure in (root, *root.subfigs):
        for key in subfigure.legends:
            key.set_visible(False)
            key.set_in_layout(False)
            if subfigure in (root, own_part):
                lent_legend = key
    if lent_legend is None:
        return None
    own_legend = axis.get_legend()
    handles = [handle for handle in lent_legend.legend_handles if handle is not None]
    texts = [text.get_text() for text in lent_legend.get_texts()]
    below = axis.legend(handles, texts, loc="upper center", ncols=2)
    if own_legend is not None:
        axis.add_artist(own_legend)
    return below


def _put_below(key: Legend, axis: Axes, canvas: FigureCanvasAgg) -> None:
    """Place a legend directly below an axis and its labels."""
    label_box = axis.xaxis.get_tightbbox(canvas.get_renderer())
    low = axis.bbox.y0 if label_box is None else min(axis.bbox.y0, label_box.y0)
    baseline = (low - axis.bbox.y0) / axis.bbox.height
    key.set_bbox_to_anchor((0.5, baseline), transform=axis.transAxes)
