"""Drawings of studies N2, N3 and AM, on learned contact laws and models."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from problems.registry import spec
from problems.studies.smoothings_compared.data import ANALYTIC, WITHIN, excess_cost, law_texts, replay_gap
from reports.drawing.strobe import draw_motion
from reports.drawing.style import BLUE, CYCLE, FAINT, GREEN, GREY, INK, ORANGE, PURPLE, VERMILLION, WIDTH
from reports.figures.studies.panels import drawing, excess_map, label_columns
from reports.tables.law_tables import broken_name, excess_text, seconds_of

_DYNAMICS_COLORS = {"f": GREY, "f_sigma": GREEN, "g_sigma": BLUE, "h": ORANGE, "h_sigma": VERMILLION}
"""Mapping from each of the five dynamics of study N2 to its colour."""
_DYNAMICS_LABELS = {
    "f": "$f$",
    "f_sigma": r"$f_\sigma$",
    "g_sigma": r"$g_\sigma$",
    "h": "$h$",
    "h_sigma": r"$h_\sigma$",
}
"""Mapping from each of the five dynamics of study N2 to its label."""
_ENDS: dict[str, dict[str, Any]] = {
    "on the model": {"linewidth": 0.7},
    "replayed": {"linewidth": 1.8},
    "IPOPT": {"marker": "o", "linestyle": "", "markerfacecolor": "white"},
    "IPOPT, replayed": {"marker": "o", "linestyle": ""},
}
"""Styles of curves and circles in study N2, for costs on the model and in the exact replay."""


@drawing(
    "Top: cost over Adam's iterations through each of the five dynamics, thin on the model, thick "
    "replayed under the exact law, medians and ranges over seeds; circles at the right are gains by "
    "IPOPT, open on the model, filled replayed. Second row: motions of the last policies under the "
    "exact law. Third row: final exact cost of policies learned through the average of data and "
    "through the noised network, over the width of the noise and the amount of data, as a multiple "
    "of the cost of standing still: less is blue, more is red. Bottom: the object's part of the cost "
    "of IPOPT's input sequences, at rest, as planned, and replayed."
)
def n2(data: xr.Dataset) -> Figure:
    """Draw study N2: learning curves, strobes, heat maps of costs, and bars of costs, for two problems."""
    figure = Figure(figsize=(WIDTH, 8.2), layout="constrained")
    subfigures: Any = figure.subfigures(4, 1, height_ratios=(2.2, 2.6, 1.7, 1.7))
    curves, strobes, maps, bars = subfigures
    names = [str(name) for name in data["problem"].values]
    for axis, name in zip(curves.subplots(1, 2), names, strict=True):
        _curves(axis, data.sel(problem=name))
        axis.set_title(name)
    curves.axes[0].set_ylabel("cost (14)")
    handles, labels = curves.axes[0].get_legend_handles_labels()
    ends = [Line2D([], [], color=INK, **look) for look in _ENDS.values()]
    curves.legend(
        [*handles, *ends],
        [*labels, *_ENDS],
        loc="outside upper center",
        ncols=9,
        columnspacing=1.0,
        handlelength=1.4,
        fontsize=7.5,
    )
    _strobes(strobes, data, names)
    _maps(maps, data, names)
    for axis, name in zip(bars.subplots(1, 2), names, strict=True):
        _costs(axis, data.sel(problem=name))
        axis.set_title(name)
    bars.axes[0].set_ylabel("cost of the object")
    bars.legend(*bars.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure


def _curves(axis: Axes, data: xr.Dataset) -> None:
    step = data["step"].values
    for kind in data["dynamics"].values:
        color = _DYNAMICS_COLORS[str(kind)]
        costs = data["learned"].sel(dynamics=kind)
        model, exact = (costs.sel(end=end).values for end in data["end"].values)
        axis.plot(step, np.median(model, axis=0), color=color, linewidth=0.7)
        axis.fill_between(step, exact.min(axis=0), exact.max(axis=0), color=color, alpha=0.15, linewidth=0)
        axis.plot(step, np.median(exact, axis=0), color=color, linewidth=1.8, label=_DYNAMICS_LABELS[str(kind)])
        planned, replayed = data["gains"].sel(dynamics=kind).values
        axis.plot(1.05 * step[-1], planned, "o", color=color, markerfacecolor="white")
        axis.plot(1.05 * step[-1], replayed, "o", color=color)
    axis.set(yscale="log", xlabel="iteration of Adam", xlim=(step[0], 1.08 * step[-1]))


def _strobes(figure: SubFigure, data: xr.Dataset, names: list[str]) -> None:
    axes = figure.subplots(len(names), data.sizes["dynamics"])
    for row, name in zip(axes, names, strict=True):
        problem_spec = spec(name)
        assert problem_spec.draw is not None
        params, nx = problem_spec.params({}), problem_spec.problem().system.nx
        for axis, kind in zip(row, data["dynamics"].values, strict=True):
            states = data["states"].sel(problem=name, dynamics=kind).values[:, :nx]
            draw_motion(axis, [problem_spec.draw(params, state) for state in states])
            axis.set(xticks=[], yticks=[], title=_DYNAMICS_LABELS[str(kind)])
            axis.grid(False)
        row[0].set_ylabel(name)


def _maps(figure: SubFigure, data: xr.Dataset, names: list[str]) -> None:
    pairs = [(name, kind) for name in names for kind in data["swept"].values]
    for axis, (name, kind) in zip(figure.subplots(1, len(pairs)), pairs, strict=True):
        problem_data = data.sel(problem=name)
        cost_at_rest = float(problem_data["learned"].sel(dynamics="f", end="exact replay").isel(seed=0, step=0))
        ratio = problem_data["final"].sel(swept=kind).values / cost_at_rest
        axis.imshow(np.log10(ratio), cmap="RdBu_r", vmin=-1.5, vmax=1.5, origin="lower", aspect="auto")
        for i, j in np.ndindex(ratio.shape):
            strong = abs(np.log10(ratio[i, j])) > 0.9
            value = f"{ratio[i, j]:.2g}" if ratio[i, j] < 30 else ">30"
            axis.text(j, i, value, ha="center", va="center", fontsize=7, color="white" if strong else INK)
        axis.set_xticks(range(ratio.shape[1]), [f"{n:.0e}".replace("e+0", "e") for n in data["amount"].values])
        axis.set_yticks(range(ratio.shape[0]), [f"{w:g}" for w in data["width"].values])
        axis.grid(False)
        axis.set(title=f"{name}, {_DYNAMICS_LABELS[str(kind)]}", xlabel="transitions")
    figure.axes[0].set_ylabel(r"width $\sigma$")


def _costs(axis: Axes, data: xr.Dataset) -> None:
    positions, kinds = np.arange(data.sizes["law"]), data["of"].values
    for offset, kind, color in zip((-0.27, 0, 0.27), kinds, (GREY, BLUE, PURPLE), strict=True):
        values = data["cost"].sel(of=kind).values
        axis.bar(positions + offset, values, 0.25, color=color, label=str(kind))
    axis.set(yscale="log", ylim=(1, 2 * float(data["cost"].max())))
    axis.set_xticks(positions, [str(law) for law in data["law"].values])


@drawing(
    "Top left: cost of each law's plan when it is replayed under the exact law, relative to the "
    "exact law's own optimum; blue within 10 %, red beyond. Small: cost of the plan on its own "
    "model, relative to the same optimum. A check mark means that the referee lets the plans of all "
    "seeds survive, a fraction those of some. Top right: processor time in seconds, including "
    "collecting and training. Values are medians over seeds. Bottom: the average of data with trust, "
    "over the weight beta of trust as a share of a step's cost at rest, median and range over seeds; "
    "left: replayed over planned cost, right: replayed cost over the cost of standing still."
)
def n3(data: xr.Dataset) -> Figure:
    """Draw study N3: the table of excess costs, and below it the effect of the weight of trust in the data."""
    figure = Figure(figsize=(WIDTH, 7.6))
    subfigures: Any = figure.subfigures(2, 1, height_ratios=(2.5, 1))
    table, trust = subfigures
    costs, seconds = table.subplots(1, 2, width_ratios=(1.75, 1))
    _excess_table(costs, data)
    _seconds(seconds, data)
    gap_axis, cost_axis = trust.subplots(1, 2)
    cost = data["trusting_cost"]
    _over_share(gap_axis, data, 1 + replay_gap(cost), "replay / plan")
    _over_share(cost_axis, data, cost.sel(motion="exact replay") / data["rest"], "replay / at rest")
    trust.legend(*gap_axis.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def _excess_table(axis: Axes, data: xr.Dataset) -> None:
    excesses = excess_cost(data).median("seed").transpose("law", "problem").values
    best = data["cost"].sel(law="exact", motion="exact replay")
    promised = (data["cost"].sel(motion="plan") / best - 1).median("seed")
    plans = promised.transpose("law", "problem").values
    n_alive, n_seeds = data["survives"].sum("seed").transpose("law", "problem").values, data.sizes["seed"]
    for (row, column), color in np.ndenumerate(excess_map(axis, excesses, WITHIN)):
        style: dict[str, Any] = {"ha": "center", "va": "center", "color": color}
        text = excess_text(float(excesses[row, column])) + _mark(int(n_alive[row, column]), n_seeds)
        axis.text(column, row - 0.16, text, **style)
        axis.text(column, row + 0.25, f"plan {excess_text(float(plans[row, column]))}", fontsize=7, **style)
    _label_problems(axis, data)
    axis.set_yticks(range(data.sizes["law"]), list(law_texts(data.attrs).values()))
    axis.set_title("exact replay over the exact optimum")


def _mark(lives: int, of: int) -> str:
    """Return a check mark if any plans survive, with their number unless all do; "" if none survives."""
    if lives == 0:
        return ""
    return r" $\checkmark$" if lives == of else rf" $\checkmark${lives}/{of}"


def _seconds(axis: Axes, data: xr.Dataset) -> None:
    seconds = seconds_of(data).transpose("law", "problem").values
    axis.imshow(np.log10(seconds), cmap="Greys", aspect="auto", vmin=-1.5, vmax=2.5, alpha=0.6)
    for (row, column), value in np.ndenumerate(seconds):
        axis.text(column, row, f"{value:.2g}", ha="center", va="center", color=INK)
    _label_problems(axis, data)
    axis.set_yticks([])
    axis.set_title("processor [s]")


def _label_problems(axis: Axes, data: xr.Dataset) -> None:
    """Label the columns with problems, and draw lines between exact, analytic and learned laws."""
    label_columns(axis, [broken_name(str(p)) for p in data["problem"].values])
    for line in (0.5, len(ANALYTIC) + 0.5):
        axis.axhline(line, color=INK, linewidth=0.9)


def _over_share(axis: Axes, data: xr.Dataset, values: xr.DataArray, label: str) -> None:
    shares = data["share"].values
    positions = np.arange(len(shares))
    for name, color in zip(data["problem"].values, CYCLE, strict=False):
        rows = values.sel(problem=name).transpose("seed", "share").values
        axis.plot(positions, np.median(rows, axis=0), "o-", color=color, label=str(name))
        axis.fill_between(positions, rows.min(axis=0), rows.max(axis=0), color=color, alpha=0.12, linewidth=0)
    axis.axhline(1, color=GREY, linewidth=0.8, linestyle="--")
    axis.set(yscale="log", xlabel="weight of trust", ylabel=label)
    axis.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.yaxis.set_minor_locator(NullLocator())
    axis.set_xticks(positions, [f"{share:g}" for share in shares])


_MODEL_COLORS = {"psi": BLUE, "network": VERMILLION}
"""Mapping from each kind of model in study AM to its colour."""
_DATA_COLORS = {"exact": BLUE, "noise": GREEN, "drag": ORANGE}
"""Mapping from each kind of data in study AM to its colour."""
_PSI_RANGE = (0.2, 5.0)
"""Range of the axis of learned parameters psi, relative to their true values."""


@drawing(
    "Top left: error of the next state on held-out transitions of random policies, over the number "
    "of transitions learned from, for the physical model with learned psi and for a network. Lines "
    "are medians over starts, bands are ranges; dashed: transitions that end in contact, dotted: "
    "prediction that nothing moves. Top right: the same at the full number, where transitions are "
    "exact, noisy, or of a hopper with a drag that the model lacks. Middle: mean of the random "
    "search's candidates, from one start; the second pass begins where psi moves again. Bottom: psi "
    "over its true value with 95 % intervals, all starts; values outside the axis are cut at its "
    "edge."
)
def am(data: xr.Dataset) -> Figure:
    """Draw study AM: model errors above, the random search in the middle, learned parameters psi below."""
    figure = Figure(figsize=(WIDTH, 7.4))
    grid = figure.add_gridspec(3, 2, height_ratios=(1.2, 0.9, 1.0))
    _over_transitions(figure.add_subplot(grid[0, 0]), data)
    _kinds(figure.add_subplot(grid[0, 1]), data)
    _parameter_paths(figure.add_subplot(grid[1, :]), data)
    _values(figure.add_subplot(grid[2, :]), data)
    return figure


def _over_transitions(axis: Axes, data: xr.Dataset) -> None:
    n = data["transitions"].values
    for model in data["model"].values:
        color = _MODEL_COLORS[str(model)]
        for region, style in (("all", "-"), ("contact", "--")):
            errors = data["errors"].sel(data="exact", model=model, where=region).values
            has_values = ~np.isnan(errors).all(axis=1)
            errors = errors[has_values]
            label = str(model) if region == "all" else f"{model}, contact"
            axis.plot(n[has_values], np.median(errors, axis=1), style, marker="o", color=color, label=label)
            if region == "all":
                axis.fill_between(
                    n[has_values], errors.min(axis=1), errors.max(axis=1), color=color, alpha=0.2, linewidth=0
                )
    axis.axhline(float(data["still"].sel(data="exact", where="all")), color=GREY, linestyle=":", label="nothing moves")
    axis.set(xscale="log", yscale="log", xlabel="transitions learned from", ylabel="mean one-step error")
    axis.set_ylim(bottom=1e-8)
    axis.legend(loc="lower left", ncols=2)


def _kinds(axis: Axes, data: xr.Dataset) -> None:
    errors = data["errors"].sel(transitions=data.attrs["data"])
    kinds, regions = [str(kind) for kind in data["data"].values], ("flight", "contact")
    for offset, (model, region) in zip(
        (-0.3, -0.1, 0.1, 0.3), ((m, w) for m in _MODEL_COLORS for w in regions), strict=True
    ):
        model_errors = errors.sel(model=model, where=region).values
        axis.bar(
            np.arange(len(kinds)) + offset,
            np.median(model_errors, axis=1),
            0.19,
            color=_MODEL_COLORS[model],
            alpha=0.5 if region == "flight" else 1.0,
            label=f"{model}, {region}",
        )
        for index, kind_errors in enumerate(model_errors):
            axis.plot(np.full(kind_errors.size, index + offset), kind_errors, ".", color=INK, markersize=3)
    axis.set(yscale="log", xticks=range(len(kinds)), ylabel="mean one-step error")
    axis.set_xticklabels(kinds)
    axis.set_ylim(top=30 * float(errors.max()))
    axis.legend(loc="upper left", ncols=2)


def _parameter_paths(axis: Axes, data: xr.Dataset) -> None:
    path = data["way"].isel(seed=0)
    for name in data["parameter"].values:
        color = {"friction": VERMILLION, "spring": GREEN, "damping": PURPLE}.get(str(name), FAINT)
        label = str(name) if color != FAINT else None
        axis.plot(
            data["iteration"].values,
            path.sel(parameter=name).values,
            color=GREY if label is None else color,
            label=label,
            linewidth=0.6 if label is None else 1.2,
        )
    axis.plot([], [], color=GREY, linewidth=0.6, label="masses, inertias")
    axis.axhline(1, color=INK, linewidth=0.6)
    axis.set(yscale="log", xlabel="iteration of the random search", ylabel="psi / truth")
    _plain(axis, (0.25, 0.5, 1, 2, 4))
    axis.legend(loc="upper right", ncols=4)


def _values(axis: Axes, data: xr.Dataset) -> None:
    learned = data.sel(transitions=data.attrs["data"])
    names, seeds = [str(name) for name in data["parameter"].values], data.sizes["seed"]
    for group, (kind, color) in enumerate(_DATA_COLORS.items()):
        for seed in range(seeds):
            seed_values = learned.sel(data=kind).isel(seed=seed)
            positions = np.arange(len(names)) + 0.27 * (group - 1) + 0.2 * (seed + 0.5) / seeds - 0.1
            psi, low, high = (np.clip(seed_values[key].values, *_PSI_RANGE) for key in ("psi", "low", "high"))
            axis.vlines(positions, low, high, color=color, linewidth=1.2)
            axis.plot(positions, psi, "o", color=color, markersize=2.5, label=kind if seed == 0 else None)
    axis.axhline(1, color=INK, linewidth=0.6)
    axis.set(yscale="log", ylim=_PSI_RANGE, ylabel="psi / truth", xticks=range(len(names)))
    axis.set_xticklabels([name.replace("_", "\n") for name in names])
    _plain(axis, (0.25, 0.5, 1, 2, 4))
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=3)


def _plain(axis: Axes, ticks: tuple[float, ...]) -> None:
    axis.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.minorticks_off()
