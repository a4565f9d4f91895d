"""Drawing of study P2."""

from __future__ import annotations

import xarray as xr
from matplotlib.figure import Figure

from reports.style import CYCLE, INK, WIDTH

caption = (
    "Heaviside objective and its smoothed form, gradient estimates and the empirical variance of "
    "one sample over the decision; lines: closed forms, marks: samples."
)
_MARKS = {"zobg": "o", "zobg-zero-noise": "^", "zobg-mean": "s", "fobg": "x"}


def draw(data: xr.Dataset) -> Figure:
    """Objective, gradient and variance over theta."""
    figure = Figure(figsize=(WIDTH, 2.6))
    left, middle, right = figure.subplots(1, 3)
    theta = data["theta"].values
    left.step(theta, data["f"], where="mid", color=INK, label="f")
    left.plot(theta, data["F"], color=CYCLE[0], label="F")
    left.plot(theta, data["F_sampled"], ".", color=CYCLE[0], markersize=3)
    left.set_ylabel("objective")
    left.legend()
    middle.plot(theta, data["gradient"], color=INK)
    right.plot(theta, data["zobg_variance"], color=INK, label="closed form")
    for color, (name, mark) in zip(CYCLE, _MARKS.items(), strict=False):
        one = data.sel(estimator=name)
        if name in ("zobg", "fobg"):
            middle.plot(theta, one["mean"], mark, color=color)
        right.plot(theta, one["variance"], mark, color=color, label=name, markersize=3)
    middle.set_ylabel("gradient")
    right.set_ylabel("variance of one sample")
    right.set_ylim(0, 1.5 * float(data["variance"].max()))
    right.legend(ncols=2, fontsize=6.5, columnspacing=0.8, handletextpad=0.2)
    for axis in (left, middle, right):
        axis.set_xlabel("$\\theta$")
    return figure
