"""What several drawings of studies share."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from reports.style import BLUE, GREY, INK, VERMILLION


def light_to_dark(number: int, first: float = 0.85, last: float = 0.05) -> np.ndarray:
    """Colours (number, 4) of a setting that grows, from light to dark; both ends in [0, 1]."""
    return mpl.colormaps["viridis"](np.linspace(first, last, number))


def unbroken(f: np.ndarray, least: float) -> np.ndarray:
    """Take out where ``f`` (n,) jumps by more than ``least``: a jump is no line."""
    return np.where(np.append(np.abs(np.diff(f)), 0) > least, np.nan, f)


def gradient_panel(
    axis: Axes, theta: ArrayLike, slope: ArrayLike, first: ArrayLike, zeroth: ArrayLike
) -> None:
    """Draw the gradient by quadrature, and both orders' estimates of it, all (n,)."""
    axis.plot(theta, slope, color=GREY, linewidth=2.5, label="$\\nabla F$")
    axis.plot(theta, first, ".", color=BLUE, label="FoBG")
    axis.plot(theta, zeroth, ".", color=VERMILLION, label="ZoBG")


def impulse_arrow(axis: Axes, place: float, start: float, end: float) -> None:
    """Let an arrow from ``start`` to ``end`` stand for an impulse, too high to be drawn."""
    axis.annotate("", (place, end), (place, start), arrowprops={"arrowstyle": "->", "color": INK})
