"""Figures of gradient estimates: the values with their intervals, and the variances."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ocp.store.stored_run import StoredRun
from reports.notation import label, symbol
from reports.style import CYCLE, INK, WIDTH

_MARKS = "os^Dvx*P+"
_NAMES = ("zobg", "fobg", "alpha", "es", "zobg-zero-noise", "zobg-mean", "zobg-antithetic",
          "alpha-variance", "alpha-fixed")  # fmt: skip
"""In this order estimators have colours and marks, the same on every page."""
_FAR = 30.0
"""Times the largest reference beyond which an axis goes on by powers of ten."""


def caption(run: StoredRun) -> str:
    """Say what is drawn."""
    if run.meta["sweep"]:
        many = run.data.sizes["component"] > 1
        what = "Norm of the estimated gradient" if many else "Estimated gradient"
        return f"{what} with 95 % intervals, and the variance of one sample (its trace)."
    return "Each component of the estimated gradient with 95 % intervals, and its variance."


def look(name: str) -> tuple[str, str]:
    """Colour and mark of an estimator; those of a name unknown here lie behind the known ones."""
    place = _NAMES.index(name) if name in _NAMES else len(_NAMES)
    return CYCLE[place % len(CYCLE)], _MARKS[place % len(_MARKS)]


def draw(run: StoredRun) -> Figure:
    """Estimates above, variances below, over what was swept or over the components."""
    figure = Figure(figsize=(WIDTH, 3.9))
    top, bottom = figure.subplots(2, 1, sharex=True)
    reach = (_along_sweep if run.meta["sweep"] else _along_components)(run, top, bottom)
    top.set_ylabel("gradient")
    _show_all(top, reach, run.data["reference"].values)
    bottom.set_ylabel("variance of one sample")
    bottom.set_yscale("log", nonpositive="mask")
    figure.legend(*top.get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure


def _show_all(axis: Axes, reach: np.ndarray, reference: np.ndarray) -> None:
    """Let the axis hold every interval, by powers of ten where some would flatten the rest."""
    ends = reach[np.isfinite(reach)]
    if not ends.size:
        return
    low, high = float(ends.min()), float(ends.max())
    margin = 0.05 * (high - low) or 1.0
    known = float(np.nanmax(np.abs(reference), initial=0.0)) if reference.size else 0.0
    if known > 0 and max(-low, high) > _FAR * known:
        axis.set_yscale("symlog", linthresh=3 * known)
    axis.set_ylim(low - margin, high + margin)


def _along_components(run: StoredRun, top: Axes, bottom: Axes) -> np.ndarray:
    data, d = run.data, run.data.sizes["component"]
    names = [str(name) for name in data["estimator"].values]
    x, ends = np.arange(d), list[np.ndarray]()
    for j, name in enumerate(names):
        one = data.isel(point=0, estimator=j)
        at = x + 0.7 * ((j + 0.5) / len(names) - 0.5)
        color, mark = look(name)
        mean, error = one["mean"].values, 1.96 * one["standard_error"].values
        ends += [mean - error, mean + error]
        top.errorbar(at, mean, error, label=name, fmt=mark, color=color, linewidth=0.8,
                     markersize=2.5)  # fmt: skip
        bottom.plot(at, one["variance"], mark, color=color, markersize=2.5)
    known = data["reference"].isel(point=0).values[0]
    if np.isfinite(known).all():
        top.hlines(known, x - 0.4, x + 0.4, color=INK, linewidth=0.7, label="reference")
        ends.append(known)
    shown = x if d <= 12 else x[:: -(-d // 12)]
    bottom.set_xticks(shown, [str(data["component"].values[i]) for i in shown])
    return np.concatenate(ends)


def _along_sweep(run: StoredRun, top: Axes, bottom: Axes) -> np.ndarray:
    data, swept = run.data, run.meta["sweep"]
    value, ends = data["value"].values, list[np.ndarray]()
    d = data.sizes["component"]

    def size(name: str, j: int) -> np.ndarray:
        values = data[name].isel(estimator=j).values
        return values[:, 0] if d == 1 else np.sqrt(np.nansum(values**2, axis=1))

    for j, name in enumerate(map(str, data["estimator"].values)):
        color, mark = look(name)
        mean, error = size("mean", j), 1.96 * size("standard_error", j)
        ends += [mean - error, mean + error]
        top.plot(value, mean, f"{mark}-", color=color, label=name)
        top.fill_between(value, mean - error, mean + error, color=color, alpha=0.2, linewidth=0)
        variance = data["variance"].isel(estimator=j).sum("component").values
        bottom.plot(value, variance, f"{mark}-", color=color)
    known = size("reference", 0)
    if np.isfinite(known).any():
        top.plot(value, known, "--", color=INK, label="reference")
        ends.append(known)
    if swept["log"]:
        bottom.set_xscale("log")
    bottom.set_xlabel(label(symbol(swept["name"]), swept["unit"]))
    return np.concatenate(ends)
