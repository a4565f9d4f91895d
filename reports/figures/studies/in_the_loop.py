"""Drawing of the study of laws in the closed loop: C1."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure

from problems.studies.laws_in_the_loop.data import (
    FEEDBACK,
    INPUTS,
    LAWS,
    relative,
    settings,
    survives,
)
from problems.studies.shared.trainings import difference
from reports.figures.studies.panels import drawing
from reports.smoothings import dearer
from reports.style import FAINT, INK, WIDTH

_CLOSE, _LEAST, _MOST = 0.1, 1e-3, 100.0
"""Excess at which the colours change, and those at which they end."""


@drawing(
    "What a closed loop costs over the best controller found on the same task, plant and seed: "
    "blue within 10 %, red beyond; the mean over seeds, and below it half of its 95 % interval. A "
    "check mark: all runs survive, at no more than twice the best cost on the model; in brackets: "
    "so many of them do. Left: planning again at every sample under each law, over two horizons. "
    "Right: gains of the linear-quadratic regulator along one plan, and that plan's inputs alone, "
    "over the first horizon. Above each column the median of the times of a sample.",
)
def c1(data: xr.Dataset) -> Figure:
    """Two heat maps, a row a task and plant, a column a controller."""
    where = settings(data)
    figure = Figure(figsize=(WIDTH, 1.3 + 0.29 * len(where)))
    left, right = figure.subplots(1, 2, width_ratios=(len(LAWS), len(FEEDBACK + INPUTS)))
    _map(left, data, list(LAWS), "run")
    _map(right, data, [*FEEDBACK, *INPUTS], "first horizon")
    left.set_yticks(range(len(where)), [plant for _, plant in where])
    firsts = [i for i, at in enumerate(where) if i == 0 or at[0] != where[i - 1][0]]
    for first, end in zip(firsts, [*firsts[1:], len(where)], strict=True):
        left.text(
            -0.2,
            (first + end - 1) / 2,
            where[first][0],
            rotation=90,
            ha="center",
            va="center",
            transform=left.get_yaxis_transform(),
        )
    right.set_yticks([])
    left.set_title("planning again")
    right.set_title("one plan, first horizon")
    return figure


def _map(axis: Axes, data: xr.Dataset, names: Sequence[str], span: str) -> None:
    where, ratio, alive = settings(data), relative(data), survives(data)
    norm = TwoSlopeNorm(np.log10(_CLOSE), np.log10(_LEAST), np.log10(_MOST))
    shown = np.empty((len(where), len(names)))
    for i, j in np.ndindex(shown.shape):
        at = {"task": where[i][0], "plant": where[i][1], "controller": names[j], "span": span}
        costs, lives = ratio.sel(at).values, int(alive.sel(at).sum())
        found = difference(costs, np.ones_like(costs))
        shown[i, j] = np.log10(np.clip(found.mean, _LEAST, _MOST))
        color = INK if 0.12 < norm(shown[i, j]) < 0.88 else "white"
        mark = r" $\checkmark$" if lives == len(costs) else f" ({lives})" if lives else ""
        spread = _spread((found.high - found.low) / 2, found.mean)
        for off, word in ((-0.2, dearer(found.mean)), (0.22, spread + mark)):
            axis.text(j, i + off, word, ha="center", va="center", color=color, fontsize=7)
    axis.imshow(shown, cmap="RdBu_r", norm=norm, aspect="auto", alpha=0.75)
    axis.grid(False)
    axis.tick_params(length=0)
    axis.xaxis.tick_top()
    times = data["ms"].sel(controller=list(names)).median(["task", "plant"]).values
    axis.set_xticks(
        range(len(names)),
        [name.replace(", ", "\n").replace(" ", "\n") + f"\n{ms:.2g} ms" for name, ms in zip(names, times, strict=True)],
        fontsize=7,
    )
    for i in range(1, len(where)):
        new = where[i][0] != where[i - 1][0]
        axis.axhline(i - 0.5, color=INK if new else FAINT, linewidth=0.8 if new else 0.4)


def _spread(half: float, mean: float) -> str:
    """Half of an interval, in the unit of its mean as :func:`~reports.smoothings.dearer` has it."""
    if mean >= 2:
        return f"±{half:.0f}" if half >= 9.5 else f"±{half:.2g}"
    return f"±{half:.1%}" if half < 0.0995 else f"±{half:.0%}"
