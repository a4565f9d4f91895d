"""Drawing of study P7."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from reports.style import CYCLE, INK, WIDTH

caption = (
    "Above: gradient estimates of one run over the decision (line: the gradient, band: the allowed "
    "error). Below: mean weight of the first order over all runs."
)
_MARKS = ("o", "x", "^", "s", "D")
_UNITS = {"heaviside": "", "coulomb": " [m/s]", "ball-wall": " [rad]"}


def draw(data: xr.Dataset) -> Figure:
    """Estimates and weights of the three cases."""
    figure = Figure(figsize=(WIDTH, 4.2))
    rows = figure.subplots(2, 3, sharex="col", height_ratios=(1.6, 1))
    for k, case in enumerate(map(str, data["case"].values)):
        one, (top, bottom) = data.sel(case=case), rows[:, k]
        theta, truth = one["theta"].values, one["truth"].values
        band = float(one["gamma_of_case"])
        top.plot(theta, truth, color=INK)
        top.fill_between(theta, truth - band, truth + band, color=INK, alpha=0.12, linewidth=0)
        for color, mark, name in zip(CYCLE, _MARKS, data["estimator"].values, strict=False):
            label = str(name) if k == 0 else None
            estimate = one.sel(estimator=name)
            top.plot(theta, estimate["mean"][:, 0], mark, color=color, markersize=3, label=label)
            if np.isfinite(estimate["alpha"]).all():
                bottom.plot(theta, estimate["alpha"].mean("run"), f"{mark}-", color=color,
                            markersize=3)  # fmt: skip
        reach = np.abs(truth).max()
        top.set_ylim(truth.min() - 0.7 * reach, truth.max() + 0.7 * reach)
        top.set_title(case)
        bottom.set_ylim(-0.05, 1.05)
        bottom.set_xlabel(f"$\\theta${_UNITS[case]}")
    rows[0, 0].set_ylabel("gradient")
    rows[1, 0].set_ylabel("weight alpha")
    figure.legend(loc="outside upper center", ncols=5)
    return figure
