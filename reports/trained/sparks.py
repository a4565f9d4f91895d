"""Curves out of letters, for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_EIGHTHS = " ▁▂▃▄▅▆▇█"


def sparkline(values: Sequence[float], width: int) -> str:
    """At most ``width`` letters from ▁, the least, to █, the largest; spaces are no numbers."""
    shown, low, high = _columns(values, width)
    return "".join(_EIGHTHS[1 + round(7 * _height(v, low, high))] if np.isfinite(v) else " "
                   for v in shown)  # fmt: skip


def plot(values: Sequence[float], width: int, height: int) -> list[str]:
    """Columns of ``height`` lines, the largest value first, with the ends told on the left."""
    shown, low, high = _columns(values, width)
    eighths = [
        1 + round((8 * height - 1) * _height(v, low, high)) if np.isfinite(v) else 0 for v in shown
    ]
    ends = {height - 1: f"{high:.4g}", 0: f"{low:.4g}"}
    margin = max(map(len, ends.values()))
    return [
        f"{ends.get(row, ''):>{margin}} ┤"
        + "".join(_EIGHTHS[min(8, max(0, count - 8 * row))] for count in eighths).rstrip()
        for row in reversed(range(height))
    ]


def _columns(values: Sequence[float], width: int) -> tuple[np.ndarray, float, float]:
    """One value a letter: the last of those that share it; and the least and the largest."""
    known = np.asarray(values, dtype=float)
    if len(known) > width:
        known = known[np.linspace(0, len(known) - 1, width).round().astype(int)]
    finite = known[np.isfinite(known)]
    return known, *((float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0))


def _height(value: float, low: float, high: float) -> float:
    return (value - low) / (high - low) if high > low else 0.5
