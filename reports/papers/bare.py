"""A figure as a paper wants it: panels with letters, column width, fonts inside the file."""

from __future__ import annotations

import io
from collections.abc import Sequence
from string import ascii_lowercase

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from ocp.errors import InputError, choose

COLUMN, BOTH = 3.5, 7.16
"""Width [inch] of a column, and of both with the gap between them, as journals of two columns."""
FORMATS = {ending: f"a .{ending} file" for ending in ("pdf", "svg", "png")}
_DPI = 300
_PAD = 0.02
_TALLEST = 0.85
"""Height of a panel on its own over its width, at most."""
_BELOW = -0.28
# Type 42: whole TrueType fonts, since publishers turn Type 3 away.
_SETTINGS = {"pdf.fonttype": 42}
_UNDATED = {
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "svg": {"Date": None, "Creator": None},
    "png": {"Software": None},
}


def bare(figure: Figure, ending: str, panel: str | None = None) -> bytes:
    """Render a drawn figure, or only its panel ``"a"``, ``"b"``, ...; the same bytes each time.

    A figure of several panels is as wide as both columns and each panel has its letter; one panel
    is as wide as a column. Works on ``figure`` itself, which is not to be used again.

    Raises :class:`~ocp.errors.InputError` for an unknown ``ending`` or panel.
    """
    choose("format", ending, FORMATS)
    shown = panels(figure)
    box = None
    if panel is not None:
        box = _alone(figure, _named(panel, shown))
    else:
        width, height = figure.get_size_inches()
        if len(shown) > 1:
            _letter(shown)
            figure.set_size_inches(BOTH, height)
        else:
            figure.set_size_inches(COLUMN, height * COLUMN / width)
    buffer = io.BytesIO()
    with mpl.rc_context(_SETTINGS):
        figure.savefig(buffer, format=ending, dpi=_DPI, bbox_inches=box, metadata=_UNDATED[ending])
    return buffer.getvalue()


def panels(figure: Figure) -> list[Axes]:
    """Axes that show something, in the order that they were laid out."""
    return [axis for axis in figure.axes if axis.axison or axis.has_data() or axis.get_title()]


def _named(panel: str, shown: Sequence[Axes]) -> Axes:
    letters = ascii_lowercase[: len(shown)]
    if len(panel) != 1 or panel not in letters:
        known = f"a to {letters[-1]}" if len(letters) > 1 else "only a"
        raise InputError(f"unknown panel {panel!r}; the figure has {known}")
    return shown[letters.index(panel)]


def _letter(shown: Sequence[Axes]) -> None:
    for letter, axis in zip(ascii_lowercase, shown, strict=False):
        place = next((loc for loc in ("left", "center") if axis.get_title(loc)), "left")
        text = f"({letter}) {axis.get_title(place)}".rstrip()
        axis.set_title(text, loc=place)  # pyright: ignore[reportArgumentType]


def _alone(figure: Figure, axis: Axes) -> Bbox:
    """Hide all but ``axis``, make it as wide as a column, and return what it covers [inch]."""
    for other in figure.axes:
        if other is not axis:
            _lend_labels(other, axis)
            other.set_visible(False)
    _lend_key(axis)
    canvas = FigureCanvasAgg(figure)
    # Fonts keep their size, so that the axes alone give way: a few rounds settle it.
    for _ in range(4):
        figure.draw_without_rendering()
        covered = _covered(axis, canvas)
        width, height = covered.width / figure.dpi, covered.height / figure.dpi
        wide, tall = figure.get_size_inches()
        growth = (COLUMN - 2 * _PAD) / width
        figure.set_size_inches(wide * growth, tall * min(growth, _TALLEST * COLUMN / height))
    figure.draw_without_rendering()
    inches = figure.dpi_scale_trans.inverted()
    return _covered(axis, canvas).transformed(inches).padded(_PAD)


def _covered(axis: Axes, canvas: FigureCanvasAgg) -> Bbox:
    """What an axis and all that belongs to it cover [pixel]."""
    covered = axis.get_tightbbox(canvas.get_renderer())
    assert covered is not None
    return covered


def _lend_labels(other: Axes, axis: Axes) -> None:
    """Give ``axis`` the labels that it left to one that it shares a scale with."""
    if axis.get_shared_x_axes().joined(axis, other):
        axis.tick_params(labelbottom=True)
        axis.set_xlabel(axis.get_xlabel() or other.get_xlabel())
    if axis.get_shared_y_axes().joined(axis, other):
        axis.tick_params(labelleft=True)
        axis.set_ylabel(axis.get_ylabel() or other.get_ylabel())


def _lend_key(axis: Axes) -> None:
    """Put the key of the whole figure below an axis that has none of its own."""
    holders = (axis.get_figure(root=False), axis.get_figure(root=True))
    keys = [key for holder in holders if holder is not None for key in holder.legends]
    if keys and axis.get_legend() is None:
        texts = [text.get_text() for text in keys[0].get_texts()]
        axis.legend(keys[0].legend_handles, texts, loc="upper center", ncols=2,
                    bbox_to_anchor=(0.5, _BELOW))  # fmt: skip
