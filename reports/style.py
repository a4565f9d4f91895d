"""How figures look: one palette safe for colour-blind readers, and files that never vary."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
from cycler import cycler
from matplotlib.figure import Figure

# Okabe and Ito's palette: every pair stays apart under the common colour deficiencies.
BLUE, VERMILLION, GREEN = "#0072B2", "#D55E00", "#009E73"
ORANGE, SKY, PURPLE, YELLOW = "#E69F00", "#56B4E9", "#CC79A7", "#F0E442"
INDIGO, WINE, OLIVE, BROWN, LIME, MAGENTA = (
    "#332288", "#882255", "#999933", "#661100", "#7FC41C", "#E6007E",
)  # fmt: skip
CYCLE = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY,
         INDIGO, WINE, OLIVE, BROWN, LIME, MAGENTA)  # fmt: skip
"""Twelve colours that stay apart, the six first ones for colour-blind readers too."""
GREY, FAINT, INK = "#7A7A7A", "#D9D9D9", "#222222"
PLANNED, REPLAYED = BLUE, VERMILLION
GRADES = {"survives": GREEN, "certified": ORANGE, "failed": VERMILLION}
"""Colours of verdicts, those of the PDFs' templates."""
WIDTH = 6.5
"""Width of the text block [inch]."""

_SETTINGS: dict[Any, Any] = {
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


@contextmanager
def styled() -> Iterator[None]:
    """Draw in the house style, whatever the user's matplotlib is set to."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_SETTINGS)
        yield


def to_svg(figure: Figure) -> bytes:
    """Render to SVG, the same bytes each time."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()
