"""Figures of how one run was solved: its homotopy, and its feedback gains."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from reports.console import shown_stages, stage_title
from reports.style import CYCLE, GREY, REPLAYED, WIDTH
from reports.units import symbol
from reports.view import RunView


def homotopy(view: RunView) -> Figure:
    """Cost, complementarity and residual after each stage; what is zero is not drawn."""
    numbers, stages = zip(*shown_stages(view.run.stages), strict=True)
    figure = Figure(figsize=(WIDTH, 1.9))
    left, right = figure.subplots(1, 2)
    number = np.array(numbers)
    kept = np.array([stage.accepted for stage in stages])
    cost = np.array([stage.cost for stage in stages], dtype=float)
    left.plot(number[kept], cost[kept], "o-")
    left.plot(number[~kept], cost[~kept], "x", color=REPLAYED, label="stepped back")
    left.set_ylabel("cost")
    curves = [
        ("complementarity", CYCLE[0], "largest λ gap"),
        ("residual", CYCLE[2], "residual"),
    ]
    labels = {stage.label for stage in stages}
    if len(labels) == 1:
        curves.append(("value", GREY, symbol(stage_title(labels.pop()))))
    for name, color, text in curves:
        values = np.array([getattr(stage, name) for stage in stages], dtype=float)
        seen = values > 0
        right.semilogy(number[seen], values[seen], "o-", color=color, label=text)
    right.set_ylabel("size")
    figure.legend(*right.get_legend_handles_labels(), loc="outside right upper")
    if not kept.all():
        left.legend()
    for axis in (left, right):
        axis.set(xlabel="stage", xlim=(number[0] - 0.5, number[-1] + 0.5))
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure


def gains(view: RunView) -> Figure:
    """Feedback gains K over time as heat maps, one a control."""
    K = view.array("K")
    assert K is not None
    states, inputs = view.signals("states"), view.signals("inputs")
    figure = Figure(figsize=(WIDTH, 0.9 + (0.45 + 0.16 * len(states)) * len(inputs)))
    axes = figure.subplots(len(inputs), 1, sharex=True, squeeze=False)[:, 0]
    # One far outlier must not wash the rest out: the colours end at the 98th percentile.
    limit = float(np.quantile(np.abs(K), 0.98)) or 1.0
    image = None
    for index, axis in enumerate(axes):
        image = axis.pcolormesh(
            np.arange(K.shape[0] + 1) - 0.5, np.arange(len(states) + 1) - 0.5, K[:, index, :].T,
            cmap="PuOr", vmin=-limit, vmax=limit,
        )  # fmt: skip
        axis.set_yticks(range(len(states)), [signal.name for signal in states])
        axis.invert_yaxis()
        axis.grid(False)
        axis.set_ylabel(inputs[index].name)
    axes[-1].set_xlabel("step")
    axes[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    assert image is not None
    bar = figure.colorbar(image, ax=list(axes), extend="both", pad=0.02)
    bar.set_label("K [input unit / state unit]")
    return figure
