"""Figures of trained policies: learning curves and motions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ocp.store.stored_run import StoredRun
from reports.drawing.notation import label
from reports.drawing.strobe import strobe, strobe_rows
from reports.drawing.style import CYCLE, GREY, INK, WIDTH
from reports.drawing.view import RunView
from reports.tables.training import SeedGroup, measure_names

_GROUP_COLORS = (*CYCLE, INK, GREY)
"""Colours of groups of training runs, in their order."""
_SIGNAL_TITLES = {
    "return_mean": "return of the samples",
    "gradient_norm": "norm of the gradient",
    "gradient_variance": "variance of a sample's gradient",
}
"""Mapping from each recorded signal of a training run to its title."""


def learning_figure(seed_groups: Sequence[SeedGroup]) -> Figure:
    """Draw return under the exact law, and the task's measures, over simulated steps and over wall time."""
    names = ["return", *measure_names(seed_groups[0].runs[0].meta["evaluation"])][:3]
    figure = Figure(figsize=(WIDTH, 1.75 * len(names) + 0.5))
    axes = figure.subplots(len(names), 2, squeeze=False, sharey="row", sharex="col")
    for row, name in zip(axes, names, strict=True):
        for axis, over in zip(row, ("env_steps", "wall_s"), strict=True):
            for index, group in enumerate(seed_groups):
                _banded(axis, group, over, f"evaluation_{name}", _color(index))
        row[0].set_ylabel(measure_label(seed_groups[0].runs[0], name))
    axes[-1, 0].set_xlabel("steps simulated")
    axes[-1, 0].ticklabel_format(axis="x", style="sci", scilimits=(-3, 4), useMathText=True)
    axes[-1, 1].set_xlabel("wall time [s]")
    _legend(figure, seed_groups)
    return figure


def signal_figure(seed_groups: Sequence[SeedGroup]) -> Figure | None:
    """Draw returns of samples, and gradients, over the iterations; return None if no run recorded any of them."""
    names = [name for name in _SIGNAL_TITLES if any(_known(group, name) for group in seed_groups)]
    if not names:
        return None
    figure = Figure(figsize=(WIDTH, 2.2))
    for axis, name in zip(figure.subplots(1, len(names), squeeze=False)[0], names, strict=True):
        for index, group in enumerate(seed_groups):
            if _known(group, name):
                _banded(axis, group, "iteration", name, _color(index))
        axis.set_title(_SIGNAL_TITLES[name], loc="left")
        axis.set_xlabel("iteration")
        if name != "return_mean" and any(np.greater(line.get_ydata(), 0).any() for line in axis.lines):
            axis.set_yscale("log", nonpositive="mask")
    _legend(figure, seed_groups)
    return figure


def strobe_figures(seed_groups: Sequence[SeedGroup]) -> list[Figure]:
    """Return strobes of an episode of each group's best policy."""
    views = [(group, RunView.of(group.best)) for group in seed_groups]
    pictured = [(group, view) for group, view in views if view.picture is not None]
    if len(pictured) == 1 and (single := strobe(pictured[0][1])) is not None:
        return [single]
    seeds = [f", seed {group.best.meta['seed']}" * (len(group.runs) > 1) for group, _ in pictured]
    titled = zip(seeds, pictured, strict=True)
    return strobe_rows([((group.label + seed).removeprefix(", "), view) for seed, (group, view) in titled])[0]


def measure_label(run: StoredRun, name: str) -> str:
    """Return the label of a measure, with its unit."""
    return label(name, str(run.data[f"evaluation_{name}"].attrs.get("units", "1")))


def _color(index: int) -> str:
    return _GROUP_COLORS[index % len(_GROUP_COLORS)]


def _known(group: SeedGroup, name: str) -> bool:
    return all(name in run.data and np.isfinite(run.data[name]).any() for run in group.runs)


def _banded(axis: Axes, group: SeedGroup, abscissa: str, name: str, color: str) -> None:
    """Draw the mean of ``name`` over seeds, and the band from the lowest to the highest seed.

    Only iterations that all seeds have are drawn; ``abscissa`` is averaged over seeds.
    """
    shortest = min(run.data.sizes["iteration"] for run in group.runs)
    values = np.stack([run.data[name].values[:shortest] for run in group.runs])
    abscissae = np.stack([run.data[abscissa].values[:shortest] for run in group.runs]).mean(axis=0)
    is_known = np.isfinite(values).all(axis=0)
    if len(group.runs) > 1:
        low, high = values[:, is_known].min(axis=0), values[:, is_known].max(axis=0)
        axis.fill_between(abscissae[is_known], low, high, color=color, alpha=0.2, linewidth=0)
    axis.plot(abscissae[is_known], values[:, is_known].mean(axis=0), color=color)


def _legend(figure: Figure, seed_groups: Sequence[SeedGroup]) -> None:
    if len(seed_groups) == 1 and len(seed_groups[0].runs) == 1:
        return
    handles = [Line2D([], [], color=_color(i), label=group.label) for i, group in enumerate(seed_groups)]
    if any(len(group.runs) > 1 for group in seed_groups):
        handles.append(Line2D([], [], color=GREY, linewidth=6, alpha=0.3, label="lowest to highest seed"))
    figure.legend(handles=handles, loc="outside upper center", ncols=min(6, len(handles)))
