"""Parts that several drawings of studies share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from reports.drawing.style import BLUE, GREY, INK, VERMILLION


@dataclass(frozen=True)
class Drawing:
    """A function that draws the data of a study, and the caption below its figure."""

    draw: Callable[[xr.Dataset], Figure]
    caption: str


def drawing(caption: str) -> Callable[[Callable[[xr.Dataset], Figure]], Drawing]:
    """Return a decorator that turns a function into a :class:`Drawing` with this caption."""
    return lambda draw: Drawing(draw, caption)


def light_to_dark(number: int, first: float = 0.85, last: float = 0.05) -> np.ndarray:
    """Return RGBA colours (number, 4) from light to dark; ``first`` and ``last`` are places on viridis in [0, 1]."""
    return mpl.colormaps["viridis"](np.linspace(first, last, number))


def unbroken(f: np.ndarray, jump: float) -> np.ndarray:
    """Return ``f`` (n,) with NaN before each change larger than ``jump``, which interrupts a line through it."""
    return np.where(np.append(np.abs(np.diff(f)), 0) > jump, np.nan, f)


def gradient_panel(axis: Axes, theta: ArrayLike, slope: ArrayLike, first: ArrayLike, zeroth: ArrayLike) -> None:
    """Draw the gradient by quadrature, and its first- and zeroth-order estimates, over ``theta``, all (n,)."""
    axis.plot(theta, slope, color=GREY, linewidth=2.5, label="$\\nabla F$")
    axis.plot(theta, first, ".", color=BLUE, label="FoBG")
    axis.plot(theta, zeroth, ".", color=VERMILLION, label="ZoBG")


def impulse_arrow(axis: Axes, place: float, start: float, end: float) -> None:
    """Draw an arrow from ``start`` to ``end`` in place of an impulse too high for the axis."""
    axis.annotate("", (place, end), (place, start), arrowprops={"arrowstyle": "->", "color": INK})


def quartile_curve(
    axis: Axes, x: ArrayLike, values: np.ndarray, color: str, style: Any = "-", label: str | None = None
) -> None:
    """Draw the median over runs of ``values`` (runs, n), and the band between the quartiles."""
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75], axis=0)
    axis.plot(x, middle, linestyle=style, color=color, label=label)
    axis.fill_between(x, low, high, color=color, alpha=0.12, linewidth=0)
