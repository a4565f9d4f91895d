"""Parts shared by several drawings of studies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
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
    """Return RGBA colours (number, 4) from light to dark; ``first`` and ``last`` are positions on viridis in [0, 1]."""
    return mpl.colormaps["viridis"](np.linspace(first, last, number))


def break_at_jumps(f: np.ndarray, jump: float) -> np.ndarray:
    """Return ``f`` (n,) with NaN before each change larger than ``jump``, so that a line through it is interrupted."""
    return np.where(np.append(np.abs(np.diff(f)), 0) > jump, np.nan, f)


def gradient_panel(axis: Axes, theta: ArrayLike, slope: ArrayLike, first: ArrayLike, zeroth: ArrayLike) -> None:
    """Draw the gradient by quadrature, and its first- and zeroth-order estimates, over ``theta``, all (n,)."""
    axis.plot(theta, slope, color=GREY, linewidth=2.5, label="$\\nabla F$")
    axis.plot(theta, first, ".", color=BLUE, label="FoBG")
    axis.plot(theta, zeroth, ".", color=VERMILLION, label="ZoBG")


EXCESS_RANGE = (1e-3, 100.0)
"""Range of the colours of a map of excess costs, relative to the lowest costs."""


def excess_map(axis: Axes, excess: np.ndarray, good: float) -> np.ndarray:
    """Draw relative excess costs (rows, columns) as a map, blue below ``good`` and red above.

    Return the colours of text on its cells, an array of the same shape.
    """
    norm = TwoSlopeNorm(np.log10(good), *np.log10(EXCESS_RANGE))
    log_excess = np.log10(np.clip(excess, *EXCESS_RANGE))
    axis.imshow(log_excess, cmap="RdBu_r", norm=norm, aspect="auto", alpha=0.75)
    shades = norm(log_excess)
    return np.where((shades > 0.12) & (shades < 0.88), INK, "white")


def label_columns(axis: Axes, labels: Sequence[str], **style: Any) -> None:
    """Write labels above the columns of a map, without its ticks and grid."""
    axis.grid(False)
    axis.tick_params(length=0)
    axis.xaxis.tick_top()
    axis.set_xticks(range(len(labels)), labels, **style)


def impulse_arrow(axis: Axes, x: float, start: float, end: float) -> None:
    """Draw an arrow from ``start`` to ``end`` for an impulse that is too high for the axis."""
    axis.annotate("", (x, end), (x, start), arrowprops={"arrowstyle": "->", "color": INK})


def quartile_curve(
    axis: Axes, x: ArrayLike, values: np.ndarray, color: str, style: Any = "-", label: str | None = None
) -> None:
    """Draw the median over runs of ``values`` (runs, n), and the band between the quartiles."""
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75], axis=0)
    axis.plot(x, middle, linestyle=style, color=color, label=label)
    axis.fill_between(x, low, high, color=color, alpha=0.12, linewidth=0)
