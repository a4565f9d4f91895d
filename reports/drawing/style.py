"""Style of all figures: a palette for colour-blind readers, and files with reproducible bytes."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from cycler import cycler
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FixedFormatter, FuncFormatter

# Okabe and Ito's hues, which stay apart under the common colour deficiencies; blue, green,
# vermillion, purple, orange and sky blue are eight steps of CIE lightness apart for print in grey.
BLUE = "#004C80"  # multipliers and planned motions
VERMILLION = "#CC5500"  # forces and replays
GREEN = "#006F51"  # gaps and goals
ORANGE = "#E69F00"  # actuators and slip
SKY = "#8CCDF2"  # plans and stick
PURPLE = "#CC79A7"  # friction cones
CYCLE = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, "#332288", "#882255", "#999933", "#661100", "#7FC41C", "#E6007E")
"""Twelve distinct colours; the first six are also distinct for colour-blind readers and in grey print."""
GREY = "#7A7A7A"  # the environment, and lines of reference
FAINT = "#D9D9D9"  # grids, and areas behind others
INK = "#222222"  # text
PLANNED = BLUE  # curves of the plan
REPLAYED = VERMILLION  # curves of the replay
GRADE_COLORS = {"survives": GREEN, "certified": ORANGE, "failed": VERMILLION}
"""Mapping from the grade of a verdict to its colour, as in the PDFs' templates."""
WIDTH = 6.5
"""Width of the text block [inch]."""

_HOUSE_RC: dict[Any, Any] = {
    "font.family": "STIXGeneral",
    "mathtext.fontset": "stix",
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.labelsize": 9,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "axes.prop_cycle": cycler(color=CYCLE),
    "axes.edgecolor": GREY,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": FAINT,
    "grid.linewidth": 0.4,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 1.2,
    "lines.markersize": 3.5,
    "figure.constrained_layout.use": True,
    # Text as outlines: the page's typesetter need not have the figure's fonts.
    "svg.fonttype": "path",
    # Identifiers inside an SVG are random unless they are salted.
    "svg.hashsalt": "centralpath",
}
"""Settings of matplotlib for all figures."""


def line_of(index: int) -> dict[str, Any]:
    """Return colour and line style of line number ``index``; they are also distinct in grey print."""
    index %= len(CYCLE)
    return {"color": CYCLE[index], "linestyle": "-" if index < 6 else _DASH_PATTERNS[index % 2]}


_DASH_PATTERNS = ((0, (5, 1.5)), (0, (1, 1)))
"""Dash patterns of the lines after the sixth: lengths on and off [line widths]."""


@contextmanager
def house_style() -> Iterator[None]:
    """Apply the house style within the context, regardless of the user's matplotlib settings."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_HOUSE_RC)
        yield


def show_literally(figure: Figure) -> Figure:
    """Make the texts of a figure literal, since names such as ``x$a_{$`` are not mathematics; return the figure.

    Numbers at ticks remain mathematics. The figure must not have been drawn before.
    """
    axes = [axis for axis in figure.findobj(Axis) if isinstance(axis, Axis)]
    numbers = {
        text
        for axis in axes
        for text in axis.findobj(Text)
        if text is not axis.label and not isinstance(axis.get_major_formatter(), FixedFormatter | FuncFormatter)
    }
    for text in figure.findobj(Text):
        if isinstance(text, Text) and text not in numbers:
            text.set_parse_math(False)
    return figure


def to_svg(figure: Figure) -> bytes:
    """Return a figure as SVG; the bytes are always the same."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()
