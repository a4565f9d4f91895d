"""Figures of a sweep, as lines, heat maps or small multiples, and of gradient estimates."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure

from ocp.store.stored_run import StoredRun
from reports.drawing.notation import label, symbol
from reports.drawing.style import CYCLE, FAINT, GRADE_COLORS, GREY, INK, PLANNED, REPLAYED, WIDTH
from reports.figures.panels import use_log_if_wide

_GRADE_TEXTS = {"failed": "fails", "certified": "certified only", "survives": "survives"}
"""Mapping from each grade to its text in legends."""
_GRADE_STYLES = {grade: (GRADE_COLORS[grade], words) for grade, words in _GRADE_TEXTS.items()}
"""Mapping from each grade to its colour and its text in legends."""
_MAX_SLICES = 4
"""Number of slices of a grid in one figure."""
_MAX_WRITTEN_CELLS = 64
"""Maximum number of cells of a map with numbers written in them."""
_MOST_TICKS = 8
"""Maximum number of labels along an axis of a map."""
_TICK_LETTERS = 22
"""Number of characters of labels along an axis above which the labels are rotated."""
_LEAST_RATIO_RANGE = 1.1
"""Minimum upper end of the colour scale of the ratio of replayed to planned cost."""
Axis = Mapping[str, Any]
"""Axis of a sweep in a run's metadata: ``name``, ``values``, ``log``, ``units``."""


def sweep_figures(data: xr.Dataset, axes: Sequence[Axis]) -> list[Figure]:
    """Return the figures of a sweep: lines over a single axis, or heat maps over the two longest of ``axes``."""
    if len(axes) == 1:
        return [_lines(data, axes[0])]
    # The two longest axes span the maps; every combination of the others' values is a slice.
    order = sorted(range(len(axes)), key=lambda i: -len(axes[i]["values"]))
    x_axis, y_axis, *other_axes = order
    slices = [*itertools.product(*(range(len(axes[i]["values"])) for i in other_axes))]
    slice_indices = [{str(axes[i]["name"]): k for i, k in zip(other_axes, indices, strict=True)} for indices in slices]
    span = axes[x_axis], axes[y_axis]
    shades = _Shades(data)
    return [
        _maps(data, span, slice_indices[k : k + _MAX_SLICES], shades) for k in range(0, len(slice_indices), _MAX_SLICES)
    ]


def sweep_caption(axes: Sequence[Axis]) -> str:
    """Return the caption of a sweep's figures."""
    if len(axes) == 1:
        return (
            "Costs, what replays cost over the plan, and iterations at each point; bars below are"
            " the verdicts' colours."
        )
    row_note = ", a row for each of the others' values" if len(axes) > 2 else ""
    return (
        "Cost under the law, the referee's cost over it (the exact law's where there is no"
        f" referee), and the verdict{row_note}; crossed cells failed,"
        " in ringed ones a neighbour's plan is better."
    )


def _outliers(data: xr.Dataset) -> np.ndarray:
    """Return a mask of the points at which a neighbour's plan is better; all False for older runs."""
    return data["outlier"].values == 1 if "outlier" in data else np.zeros(data["cost"].shape, dtype=bool)


def replayed_ratio(data: xr.Dataset) -> xr.DataArray:
    """Return the ratio of replayed cost (referee, else exact law) to planned cost; NaN at failed points."""
    replayed_cost = data["referee_cost"].where(np.isfinite(data["referee_cost"]), data["exact_cost"])
    return (replayed_cost / data["cost"]).where(data["success"] == 1)


def _lines(data: xr.Dataset, axis: Axis) -> Figure:
    figure = Figure(figsize=(WIDTH, 5.0))
    top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=(2, 1.3, 1))
    x, succeeded = np.asarray(axis["values"], dtype=float), data["success"].values == 1
    for name, texts, color, style in (
        ("cost", "cost under the law", PLANNED, "o-"),
        ("exact_cost", "under exact physics", REPLAYED, "s--"),
        ("referee_cost", "by the referee", CYCLE[2], "^:"),
    ):
        values = np.where(succeeded, data[name].values, np.nan)
        if np.isfinite(values).any():
            top.plot(x, values, style, color=color, label=texts)
    if "own_cost" in data and np.isfinite(data["own_cost"].values).any():
        top.plot(x, data["own_cost"].values, "x", color=GREY, label="outlier: its own solve")
    if _outliers(data).any():
        neighbour_cost = np.where(_outliers(data), data["neighbour_cost"].values, np.nan)
        top.plot(x, neighbour_cost, "_", color=INK, markersize=14, label="outlier: a neighbour's plan")
    use_log_if_wide(top, data[["cost", "exact_cost"]].to_array().values[:, succeeded])
    top.set_ylabel("cost")
    middle.axhline(1, color=GREY, linewidth=0.8)
    middle.plot(x, replayed_ratio(data).values, "o-", color=CYCLE[4])
    middle.set_ylabel("replayed / planned")
    bottom.plot(x, np.where(succeeded, data["iterations"].values, np.nan), "o-", color=CYCLE[3])
    bottom.set(ylim=(0, 1.15 * max(1, int(data["iterations"].max()))), ylabel="iterations", xlabel=_titled(axis))
    if axis["log"]:
        bottom.set_xscale("log")
    for position, grade in zip(x, data["grade"].values, strict=True):
        color, _ = _GRADE_STYLES[str(grade)]
        for panel in (top, middle, bottom):
            panel.axvline(position, ymax=0.035, color=color, linewidth=3, solid_capstyle="butt")
            if grade == "failed":
                panel.axvline(position, color=color, linestyle=":", linewidth=0.9)
    _legend(figure, top, data)
    return figure


def _legend(figure: Figure, axes: Axes, data: xr.Dataset) -> None:
    from matplotlib.patches import Patch

    handles, texts = axes.get_legend_handles_labels()
    present_grades = set(map(str, data["grade"].values.ravel()))
    shown_grades = [_GRADE_STYLES[grade] for grade in _GRADE_STYLES if grade in present_grades]
    patches = [Patch(color=color, label=text) for color, text in shown_grades]
    figure.legend(
        [*handles, *patches], [*texts, *(text for _, text in shown_grades)], loc="outside upper center", ncols=3
    )


class _Shades:
    """Colour scales shared by all slices: of costs, and of ratios of replayed to planned cost."""

    def __init__(self, data: xr.Dataset) -> None:
        self.cost = _norm(data["cost"].where(data["success"] == 1).values)
        ratio = replayed_ratio(data).values
        finite = ratio[np.isfinite(ratio) & (ratio > 0)]
        reach = float(np.exp(np.abs(np.log(finite)).max(initial=0.0)))
        self.ratio = LogNorm(1 / max(reach, _LEAST_RATIO_RANGE), max(reach, _LEAST_RATIO_RANGE))


def _norm(values: np.ndarray) -> Normalize:
    finite = values[np.isfinite(values)]
    if not finite.size:
        return Normalize(0, 1)
    low, high = float(finite.min()), float(finite.max())
    if low == high:
        return Normalize(low - 0.5 * abs(low) - 1e-9, high + 0.5 * abs(high) + 1e-9)
    return LogNorm(low, high) if low > 0 and high > 20 * low else Normalize(low, high)


def _maps(data: xr.Dataset, span: tuple[Axis, Axis], slices: Sequence[Mapping[str, int]], shades: _Shades) -> Figure:
    figure = Figure(figsize=(WIDTH, 0.7 + 2.1 * len(slices)))
    grid = figure.subplots(len(slices), 3, sharex=True, sharey=True, squeeze=False)
    meshes: list[Any] = []
    for row, chosen in zip(grid, slices, strict=True):
        slice_data = data.isel(chosen).transpose(span[1]["name"], span[0]["name"], ...)
        succeeded = slice_data["success"].values == 1
        cost, ratio = np.where(succeeded, slice_data["cost"].values, np.nan), replayed_ratio(slice_data).values
        meshes = [
            _map(row[0], cost, shades.cost, "cividis"),
            _map(row[1], ratio, shades.ratio, "PuOr_r"),
            _verdicts(row[2], slice_data["grade"].values),
        ]
        for axes in row:
            rows, columns = np.nonzero(~succeeded)
            axes.plot(columns, rows, "x", color=INK, markersize=4, linewidth=0)
            rows, columns = np.nonzero(_outliers(slice_data))
            axes.plot(columns, rows, "o", color=INK, markersize=14, linewidth=0, fillstyle="none")
        texts = ", ".join(f"{name} = {float(data[name].values[k]):.4g}" for name, k in chosen.items())
        row[0].set_ylabel(_titled(span[1]) + (f"\n{texts}" if texts else ""))
    for axes, title in zip(grid[0], ("cost", "replayed / planned", "verdict"), strict=True):
        axes.set_title(title)
    for axes in grid[-1]:
        axes.set_xlabel(_titled(span[0]))
        _ticks(axes.xaxis, span[0], horizontal=True)
    _ticks(grid[-1][0].yaxis, span[1])
    for column, shade in enumerate((shades.cost, shades.ratio)):
        _scale(figure, meshes[column], [*grid[:, column]], shade)
    _legend(figure, grid[0][0], data)
    return figure


def _map(axes: Axes, values: np.ndarray, norm: Normalize, colours: str) -> Any:
    mesh = _mesh(axes, values, norm, colours)
    if values.size <= _MAX_WRITTEN_CELLS:
        for (i, j), value in np.ndenumerate(values):
            if np.isfinite(value):
                color = _text_color(mesh.cmap(norm(value)))
                axes.text(j, i, f"{value:.3g}", ha="center", va="center", fontsize=7, color=color)
    return mesh


def _verdicts(axes: Axes, grades: np.ndarray) -> Any:
    kinds = list(_GRADE_STYLES)
    codes = np.vectorize(kinds.index, otypes=[float])(grades)
    colours = ListedColormap([color for color, _ in _GRADE_STYLES.values()])
    return _mesh(axes, codes, Normalize(-0.5, len(kinds) - 0.5), colours)


def _mesh(axes: Axes, values: np.ndarray, norm: Normalize, colours: str | ListedColormap) -> Any:
    """Draw ``values`` (n_y, n_x) as cells around integer coordinates, and return the mesh."""
    edges = [np.arange(size + 1) - 0.5 for size in reversed(values.shape)]
    mesh = axes.pcolormesh(*edges, values, norm=norm, cmap=colours, rasterized=values.size > 2500)
    axes.grid(False)
    axes.set_facecolor(FAINT)
    axes.set(xlim=edges[0][[0, -1]], ylim=edges[1][[0, -1]])
    return mesh


def _text_color(colour: tuple[float, float, float, float]) -> str:
    """Return the colour of text, black or white, that contrasts with a background colour."""
    red, green, blue, _ = colour
    return INK if 0.299 * red + 0.587 * green + 0.114 * blue > 0.5 else "white"


def _scale(figure: Figure, mesh: Any, axes: list[Axes], shade: Normalize) -> None:
    bar = figure.colorbar(mesh, ax=axes, location="bottom", aspect=30, pad=0.02)
    low, high = float(shade.vmin or 0.0), float(shade.vmax or 1.0)
    middle = (low * high) ** 0.5 if isinstance(shade, LogNorm) else (low + high) / 2
    bar.set_ticks([low, middle, high], labels=[f"{value:.3g}" for value in (low, middle, high)])
    bar.minorticks_off()


def _ticks(axis: Any, swept_axis: Axis, horizontal: bool = False) -> None:
    count = len(swept_axis["values"])
    tick_places = np.arange(0, count, -(-count // _MOST_TICKS))
    texts = [f"{swept_axis['values'][k]:.3g}" for k in tick_places]
    is_turned = horizontal and len(texts) * max(map(len, texts)) > _TICK_LETTERS
    axis.set_ticks(tick_places, texts, **({"rotation": 40, "ha": "right"} if is_turned else {}))


def _titled(axis: Axis) -> str:
    name = str(axis["name"]).removeprefix("setting.")
    return label(name, "" if axis["units"] == "1" else axis["units"])


_ESTIMATOR_MARKERS = "os^Dvx*P+"
"""Markers of estimators, in the order of :data:`_NAMES`."""
_NAMES = (
    "zobg",
    "fobg",
    "alpha",
    "es",
    "zobg-zero-noise",
    "zobg-mean",
    "zobg-antithetic",
    "alpha-variance",
    "alpha-fixed",
)
"""Names of estimators, in the order of their colours and markers (the same on every page)."""
_LOG_RATIO = 30.0
"""Ratio of interval ends to the largest reference gradient above which the axis is logarithmic."""


def estimate_caption(run: StoredRun) -> str:
    """Return the caption of an estimate's figure."""
    if run.meta["sweep"]:
        is_vector = run.data.sizes["component"] > 1
        quantity = "Norm of the estimated gradient" if is_vector else "Estimated gradient"
        return f"{quantity} with 95 % intervals, and the variance of one sample (its trace)."
    return "Each component of the estimated gradient with 95 % intervals, and its variance."


def estimator_style(name: str) -> tuple[str, str]:
    """Return colour and marker of an estimator; all unknown names have the same pair."""
    index = _NAMES.index(name) if name in _NAMES else len(_NAMES)
    return CYCLE[index % len(CYCLE)], _ESTIMATOR_MARKERS[index % len(_ESTIMATOR_MARKERS)]


def estimate_figure(run: StoredRun) -> Figure:
    """Draw estimates above variances, over the swept quantity or over the components."""
    figure = Figure(figsize=(WIDTH, 3.9))
    top, bottom = figure.subplots(2, 1, sharex=True)
    reach = (_along_sweep if run.meta["sweep"] else _along_components)(run, top, bottom)
    top.set_ylabel("gradient")
    _show_all(top, reach, run.data["reference"].values)
    bottom.set_ylabel("variance of one sample")
    bottom.set_yscale("log", nonpositive="mask")
    figure.legend(*top.get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure


def _show_all(axis: Axes, interval_ends: np.ndarray, reference: np.ndarray) -> None:
    """Fit the axis to all intervals; the scale is symmetric-log if long intervals would hide the others."""
    ends = interval_ends[np.isfinite(interval_ends)]
    if not ends.size:
        return
    low, high = float(ends.min()), float(ends.max())
    margin = 0.05 * (high - low) or 1.0
    largest_reference = float(np.nanmax(np.abs(reference), initial=0.0)) if reference.size else 0.0
    if largest_reference > 0 and max(-low, high) > _LOG_RATIO * largest_reference:
        # If the threshold is a power of ten, the labels of ticks next to zero do not overlap the label at zero.
        axis.set_yscale("symlog", linthresh=10 ** np.ceil(np.log10(3 * largest_reference)))
    axis.set_ylim(low - margin, high + margin)


def _along_components(run: StoredRun, top: Axes, bottom: Axes) -> np.ndarray:
    data, d = run.data, run.data.sizes["component"]
    names = [str(name) for name in data["estimator"].values]
    x, ends = np.arange(d), list[np.ndarray]()
    for j, name in enumerate(names):
        estimates = data.isel(point=0, estimator=j)
        positions = x + 0.7 * ((j + 0.5) / len(names) - 0.5)
        color, mark = estimator_style(name)
        mean, error = estimates["mean"].values, 1.96 * estimates["standard_error"].values
        ends += [mean - error, mean + error]
        top.errorbar(positions, mean, error, label=name, fmt=mark, color=color, linewidth=0.8, markersize=2.5)
        bottom.plot(positions, estimates["variance"], mark, color=color, markersize=2.5)
    reference = data["reference"].isel(point=0).values[0]
    if np.isfinite(reference).all():
        top.hlines(reference, x - 0.4, x + 0.4, color=INK, linewidth=0.7, label="reference")
        ends.append(reference)
    tick_places = x if d <= 12 else x[:: -(-d // 12)]
    bottom.set_xticks(tick_places, [str(data["component"].values[i]) for i in tick_places])
    return np.concatenate(ends)


def _along_sweep(run: StoredRun, top: Axes, bottom: Axes) -> np.ndarray:
    data, swept = run.data, run.meta["sweep"]
    value, ends = data["value"].values, list[np.ndarray]()
    d = data.sizes["component"]

    def size(name: str, j: int) -> np.ndarray:
        values = data[name].isel(estimator=j).values
        return values[:, 0] if d == 1 else np.sqrt(np.nansum(values**2, axis=1))

    for j, name in enumerate(map(str, data["estimator"].values)):
        color, mark = estimator_style(name)
        mean, error = size("mean", j), 1.96 * size("standard_error", j)
        ends += [mean - error, mean + error]
        top.plot(value, mean, f"{mark}-", color=color, label=name)
        top.fill_between(value, mean - error, mean + error, color=color, alpha=0.2, linewidth=0)
        variance = data["variance"].isel(estimator=j).sum("component").values
        bottom.plot(value, variance, f"{mark}-", color=color)
    reference = size("reference", 0)
    if np.isfinite(reference).any():
        top.plot(value, reference, "--", color=INK, label="reference")
        ends.append(reference)
    if swept["log"]:
        bottom.set_xscale("log")
    bottom.set_xlabel(label(symbol(swept["name"]), swept["unit"]))
    return np.concatenate(ends)
