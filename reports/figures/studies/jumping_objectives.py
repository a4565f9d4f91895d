"""Drawing of study P1."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from reports.figures.studies.panels import gradient_panel, unbroken
from reports.style import INK, VERMILLION, WIDTH

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
        f = data[f"f_{name}"].values
        top.plot(data[f"fine_{name}"], unbroken(f, 0.05 * np.ptp(f)), color=INK, label="$f$")
        top.plot(theta, data[f"F_{name}"], color=VERMILLION, label="$F$")
        estimates = (data[f"{order}_{name}"][:, 0] for order in ("first", "zeroth"))
        gradient_panel(bottom, theta, data[f"slope_{name}"], *estimates)
        top.set_title(title)
        top.set_ylabel(objective)
        bottom.set(xlabel=decision, ylabel=f"gradient {unit}")
    axes[0, 0].legend()
    axes[1, 1].legend(loc="lower right")
    return figure
