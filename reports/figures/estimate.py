"""Figures of gradient estimates: the values with their intervals, and the variances."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ocp.store.stored_run import StoredRun
from reports.figures.run import label
from reports.style import CYCLE, INK, WIDTH

_MARKS = "os^Dvx*P+"


def caption(run: StoredRun) -> str:
    """Say what is drawn."""
    if run.meta["sweep"]:
        many = run.data.sizes["component"] > 1
        what = "Norm of the estimated gradient" if many else "Estimated gradient"
        return f"{what} with 95 % intervals, and the variance of one sample (its trace)."
    return "Each component of the estimated gradient with 95 % intervals, and its variance."


def draw(run: StoredRun) -> Figure:
    """Estimates above, variances below, over what was swept or over the components."""
    figure = Figure(figsize=(WIDTH, 4.6))
    top, bottom = figure.subplots(2, 1, sharex=True)
    (_along_sweep if run.meta["sweep"] else _along_components)(run, top, bottom)
    top.set_ylabel("gradient")
    bottom.set_ylabel("variance of one sample")
    bottom.set_yscale("log", nonpositive="mask")
    figure.legend(*top.get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure


def _along_components(run: StoredRun, top, bottom) -> None:
    data, d = run.data, run.data.sizes["component"]
    names = [str(name) for name in data["estimator"].values]
    x = np.arange(d)
    for j, name in enumerate(names):
        one = data.isel(point=0, estimator=j)
        at = x + 0.5 * ((j + 0.5) / len(names) - 0.5)
        style = {"fmt": _MARKS[j % len(_MARKS)], "color": CYCLE[j % len(CYCLE)], "linewidth": 0.8}
        top.errorbar(at, one["mean"], 1.96 * one["standard_error"], label=name, **style)
        bottom.plot(at, one["variance"], _MARKS[j % len(_MARKS)], color=CYCLE[j % len(CYCLE)])
    known = data["reference"].isel(point=0).values[0]
    if np.isfinite(known).all():
        top.plot(x, known, "_", color=INK, markersize=12, label="reference")
    shown = x if d <= 12 else x[:: -(-d // 12)]
    bottom.set_xticks(shown, [str(data["component"].values[i]) for i in shown])


def _along_sweep(run: StoredRun, top, bottom) -> None:
    data, swept = run.data, run.meta["sweep"]
    value = data["value"].values
    d = data.sizes["component"]

    def size(name: str, j: int) -> np.ndarray:
        values = data[name].isel(estimator=j).values
        return values[:, 0] if d == 1 else np.sqrt(np.nansum(values**2, axis=1))

    for j, name in enumerate(map(str, data["estimator"].values)):
        color, mark = CYCLE[j % len(CYCLE)], _MARKS[j % len(_MARKS)]
        mean, error = size("mean", j), 1.96 * size("standard_error", j)
        top.plot(value, mean, f"{mark}-", color=color, label=name)
        top.fill_between(value, mean - error, mean + error, color=color, alpha=0.2, linewidth=0)
        variance = data["variance"].isel(estimator=j).sum("component").values
        bottom.plot(value, variance, f"{mark}-", color=color)
    known = size("reference", 0)
    if np.isfinite(known).any():
        top.plot(value, known, "--", color=INK, label="reference")
        # One lucky sample of a stiff cost would flatten all the rest.
        reach = 3 * np.nanmax(np.abs(known)) or 1.0
        low, high = top.get_ylim()
        top.set_ylim(max(low, -reach), min(high, reach))
    if swept["log"]:
        bottom.set_xscale("log")
    bottom.set_xlabel(label(swept["name"], "" if swept["unit"] == "1" else swept["unit"]))
