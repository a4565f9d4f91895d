"""Drawings of studies A3, A4, A5, A7 and AT, on policy gradients."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from problems.studies.convergence_bound import bound_sides
from problems.studies.trained_policies.data import METHODS, MODEL_BASED
from problems.studies.unroll_variance import variance_growth
from reports.drawing.style import CYCLE, INK, WIDTH, line_of
from reports.figures.studies.panels import drawing, quartile_curve


@drawing(
    "Left: variance of one unroll's gradient, mean over the policies of a training (band: their "
    "range). Right: growth of its logarithm a step from H = 5 on, with twice its standard error."
)
def a3(data: xr.Dataset) -> Figure:
    """Draw study A3: gradient variances over the length of an unroll, and their growth rate under each law."""
    figure = Figure(figsize=(WIDTH, 4.6))
    tasks, laws = list(map(str, data["task"].values)), list(map(str, data["law"].values))
    panels = figure.subplots(len(tasks), 2, width_ratios=(1.6, 1))
    lengths = data["length"].values
    for (curves, rates), task in zip(panels, tasks, strict=True):
        for k, (law, color) in enumerate(zip(laws, CYCLE, strict=False)):
            values = data["variance"].sel(task=task, law=law).values
            style = "--" if law == "adaptive" else "-"
            label = law if task == tasks[0] else None
            curves.semilogy(lengths, np.nanmean(values, axis=0), style, color=color, label=label)
            curves.fill_between(
                lengths, np.nanmin(values, axis=0), np.nanmax(values, axis=0), color=color, alpha=0.07, linewidth=0
            )
            growth_rate = variance_growth(data, task, law)
            rates.errorbar(
                [k], [growth_rate.rate], yerr=[[growth_rate.rate - growth_rate.low]], fmt="o", color=color, markersize=4
            )
        rates.axhline(0, color=INK, linewidth=0.6)
        rates.set_xticks(range(len(laws)), laws, rotation=45)
        curves.set(title=task, ylabel="variance")
        rates.set_ylabel("growth [1/step]")
    panels[-1][0].set_xlabel("unroll length H")
    figure.legend(loc="outside upper center", ncols=6)
    return figure


@drawing(
    "Top: returns of whole episodes under the exact law, median and middle half over seeds: of all "
    "but MBPO over simulated steps, of MBPO over its own steps, and of all over wall time. Bottom: "
    "return of every seed's policy over the steps of a plan from the same starts, as a share of the "
    "return of the best plan's inputs."
)
def a4(data: xr.Dataset) -> Figure:
    """Draw study A4: returns over steps and time, one row per task, then fractions of the best plan's return."""
    figure = Figure(figsize=(WIDTH, 7.2))
    tasks = list(map(str, data["task"].values))
    subfigures: Any = figure.subfigures(2, 1, height_ratios=[2 * len(tasks), 1.6])
    above, below = subfigures
    rows = above.subplots(len(tasks), 3, squeeze=False, sharey="row", width_ratios=[2, 0.9, 1.3])
    for row, task in zip(rows, tasks, strict=True):
        task_data, is_first = data.sel(task=task), task == tasks[0]
        curves(row[0], task_data["by_steps"].drop_sel(algorithm=MODEL_BASED), "steps", with_labels=is_first)
        model_based = task_data["model_based"].expand_dims(algorithm=[MODEL_BASED])
        curves(row[1], model_based, "few", with_labels=is_first)
        curves(row[2], task_data["by_time"], "wall", with_labels=False)
        row[0].set(ylabel="exact return", title=task, xlabel="simulated steps")
        row[0].locator_params(axis="x", nbins=4)
        row[1].set_xlabel("steps of MBPO")
        row[2].set_xlabel("wall time [s]")
    for axes, task in zip(below.subplots(1, len(tasks), sharey=True), tasks, strict=True):
        shares(axes, data.sel(task=task))
        axes.set(title=task, xlabel="share of the best plan's return")
    above.legend(loc="outside upper center", ncols=4)
    return figure


def shares(axes: Axes, data: xr.Dataset) -> None:
    """Draw the fraction of the best plan's return of each run, a line per algorithm, with a stroke at the median."""
    best = data["replayed"].max("guess").mean("start")
    shares_of_best = (data["reached"].mean("start") / best).transpose("algorithm", "run").values
    for k, run_shares in enumerate(shares_of_best):
        axes.plot(run_shares, np.full(run_shares.shape, k), "o", color=CYCLE[k % len(CYCLE)], ms=3, alpha=0.6)
        axes.plot(np.median(run_shares), k, "|", color=CYCLE[k % len(CYCLE)], ms=9)
    axes.axvline(1.0, color="0.6", linewidth=0.8)
    axes.set_yticks(range(len(shares_of_best)), [str(name) for name in data["algorithm"].values])
    axes.set_ylim(len(shares_of_best) - 0.5, -0.5)


def curves(axes: Axes, data: xr.DataArray, dimension: str, with_labels: bool) -> None:
    """Draw median and quartiles over runs of ``data`` (algorithm, run, dimension) where all runs have values."""
    for name in map(str, data["algorithm"].values):
        values = data.sel(algorithm=name).transpose("run", dimension).values
        is_known = np.isfinite(values).all(axis=0)
        color, style = line_of(list(METHODS).index(name)).values()
        axis_values = data[dimension].values[is_known]
        quartile_curve(axes, axis_values, values[:, is_known], color, style, name if with_labels else None)


@drawing(
    "Left: return of whole episodes under the exact law, median over seeds and middle half. Right: "
    "variance of one unroll's gradient, median over seeds."
)
def a5(data: xr.Dataset) -> Figure:
    """Draw study A5: returns under the exact law, and gradient variances, over iterations."""
    figure = Figure(figsize=(WIDTH, 3.2))
    returns, spread = figure.subplots(1, 2, width_ratios=(1.4, 1))
    iterations = data["iteration"].values
    for law, color in zip(map(str, data["law"].values), CYCLE, strict=False):
        law_data = data.sel(law=law)
        quartile_curve(returns, iterations, law_data["exact_return"].values, color, label=law)
        spread.semilogy(np.nanmedian(law_data["variance"].values, axis=0), color=color)
    returns.set(xlabel="iteration", ylabel="exact return")
    spread.set(xlabel="iteration", ylabel="variance of the gradient")
    figure.legend(loc="outside upper center", ncols=6)
    return figure


_A7_LAWS = (("FOPG", "exact"), ("BS 0.01", "barrier, 1e-2"), ("ABS quartic", "adaptive"))
"""Method and title of each landscape in study A7."""
_A7_SMALLEST_LOSS = 1e-5
"""Smallest loss on the axis of study A7 [m²]."""


@drawing(
    "Top: minus the exact return of the decision, over iterations, median and quartiles over runs. "
    "Bottom: the return over angle and speed under three laws, light where it is high, with the "
    "iterates of one run, its end (dot) and the throw to the goal (cross)."
)
def a7(data: xr.Dataset) -> Figure:
    """Draw study A7: losses of all methods over iterations, above the landscapes of three laws."""
    figure = Figure(figsize=(WIDTH, 5.2))
    grid = figure.add_gridspec(2, 3, height_ratios=(1.1, 1))
    curves = figure.add_subplot(grid[0, :])
    colors = dict[str, str]()
    for k, method in enumerate(map(str, data["algorithm"].values)):
        colors[method], style = line_of(k).values()
        loss = np.maximum(-data["exact_return"].sel(algorithm=method).values, _A7_SMALLEST_LOSS)
        quartile_curve(curves, np.arange(loss.shape[-1]), loss, colors[method], style, method)
    curves.set(yscale="log", xlabel="iteration", ylabel="minus return [$m^2$]")
    curves.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    losses = -data["landscape"].sel(law=[law for law, _ in _A7_LAWS]).values
    levels = np.geomspace(max(losses.min(), 1e-2), losses.max(), 12)
    for k, (law, title) in enumerate(_A7_LAWS):
        axes = figure.add_subplot(grid[1, k])
        loss = np.maximum(-data["landscape"].sel(law=law).values, levels[0])
        axes.contourf(data["theta"], data["s"], np.log10(loss).T, levels=np.log10(levels), cmap="Greys")
        iterates = data.sel(algorithm=law).isel(run=0)
        axes.plot(iterates["angle"], iterates["speed"], ".-", color=colors[law], markersize=2, linewidth=0.8)
        axes.plot(iterates["angle"][-1], iterates["speed"][-1], "o", color=colors[law], markersize=5)
        axes.plot([0.6], [3.0], "+", color=INK, markersize=7)
        axes.set(
            xlim=(float(data["theta"].min()), float(data["theta"].max())),
            ylim=(float(data["s"].min()), float(data["s"].max())),
            title=title,
            xlabel="angle [rad]",
        )
        if k == 0:
            axes.set_ylabel("speed [m/s]")
    return figure


@drawing(
    "Left: mean square norm of the gradient of J over the steps of ascent, mean over runs. Middle: "
    "bias and variance of the batch's gradient, means over runs. Right: the smallest mean square "
    "norm (dot) and the bound on it (bar)."
)
def at(data: xr.Dataset) -> Figure:
    """Draw study AT: gradient norms, bias and variance over steps, and both sides of the convergence bound."""
    figure = Figure(figsize=(WIDTH, 3.0))
    norms, terms, sides = figure.subplots(1, 3, width_ratios=(1.2, 1.2, 1))
    laws = [str(law) for law in data["law"].values]
    for law, color in zip(laws, CYCLE, strict=False):
        law_data = data.sel(law=law)
        norms.semilogy((law_data["slope"] ** 2).mean("run"), color=color, label=law)
        terms.semilogy(law_data["bias"].mean("run"), "-", color=color)
        terms.semilogy(law_data["variance"].mean("run"), ":", color=color)
    norms.set(xlabel="step", ylabel="mean square gradient [$m^4$]")
    terms.set(xlabel="step", ylabel="bias (line), variance (dots)")
    both_sides = np.array([bound_sides(data, law) for law in laws])
    positions = np.arange(len(laws))
    sides.bar(positions, both_sides[:, 1], color=list(CYCLE[: len(laws)]), alpha=0.4)
    sides.plot(positions, both_sides[:, 0], "o", color=INK)
    sides.set(yscale="log", ylabel="[$m^4$]")
    sides.set_xticks(positions, laws, rotation=60)
    figure.legend(*norms.get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure
