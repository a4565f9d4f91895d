"""Drawing of study P1."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from reports.style import BLUE, GREY, INK, VERMILLION, WIDTH

caption = (
    "Top: the objective (black) and its smoothing over the decision. Bottom: the gradient of the "
    "smoothed objective by quadrature (grey), and the estimates from equally many samples."
)
_PANELS = (
    ("drop", "A. dropped ball", "drop at $\\theta$ [m]", "minus height [m]", "[m/m]"),
    ("throw", "B. throw past a wall", "angle $\\theta$ [rad]", "minus distance$^2$ [m$^2$]",
     "[m$^2$/rad]"),
    ("pivot", "C. pivoted bar", "angle $\\theta$ [rad]", "$-\\omega^2$ [s$^{-2}$]",
     "[s$^{-2}$/rad]"),
)  # fmt: skip


def draw(data: xr.Dataset) -> Figure:
    """Objectives above gradients, one column a system."""
    figure = Figure(figsize=(WIDTH, 4.6))
    axes = figure.subplots(2, 3)
    for column, (name, title, decision, objective, unit) in enumerate(_PANELS):
        top, bottom = axes[:, column]
        theta = data[f"theta_{name}"].values
        fine, f = data[f"fine_{name}"].values, data[f"f_{name}"].values.copy()
        # A jump is no line.
        f[:-1][np.abs(np.diff(f)) > 0.05 * np.ptp(f)] = np.nan
        top.plot(fine, f, color=INK, label="$f$")
        top.plot(theta, data[f"F_{name}"], color=VERMILLION, label="$F$")
        bottom.plot(theta, data[f"slope_{name}"], color=GREY, linewidth=2.5, label="$\\nabla F$")
        bottom.plot(theta, data[f"first_{name}"][:, 0], ".", color=BLUE, label="FoBG")
        bottom.plot(theta, data[f"zeroth_{name}"][:, 0], ".", color=VERMILLION, label="ZoBG")
        top.set_title(title)
        top.set_ylabel(objective)
        bottom.set_ylabel(f"gradient {unit}")
        bottom.set_xlabel(decision)
    axes[0, 0].legend()
    axes[1, 1].legend(loc="lower right")
    return figure
