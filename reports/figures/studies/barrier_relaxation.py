"""Drawing of study P6."""

from __future__ import annotations

import xarray as xr
from matplotlib.figure import Figure

from reports.figures.studies.panels import light_to_dark
from reports.style import INK, WIDTH

caption = (
    "Next position and its slope over the input impulse at (x, v) = 0: the QP of eq. 3 (dashed) "
    "and the log barrier of eq. 4 (lines: contact law; dots: closed form of eq. 5)."
)


def draw(data: xr.Dataset) -> Figure:
    """Next position, and its derivative, over the input."""
    figure = Figure(figsize=(WIDTH, 3.0))
    left, right = figure.subplots(1, 2)
    u, kappas = data["u"].values, data["kappa"].values
    shades = light_to_dark(len(kappas))
    for index, (kappa, shade) in enumerate(zip(kappas, shades, strict=True)):
        left.plot(
            u, data["x_barrier"][index], color=shade, label=f"$\\kappa$ = {kappa:g} J$^{{-1}}$"
        )
        left.plot(u[::10], data["x_eq5"][index][::10], ".", color=shade, markersize=3)
        right.plot(u, data["slope_barrier"][index], color=shade)
    for axis, name in ((left, "x_qp"), (right, "slope_exact")):
        axis.plot(
            u, data[name], "--", color=INK, linewidth=1.0, label="QP" if axis is left else None
        )
        axis.set_xlabel("input impulse $u$ [N s]")
    left.set_ylabel("next position $x^+$ [m]")
    right.set_ylabel("$\\partial x^+ / \\partial u$ [m/(N s)]")
    left.legend()
    return figure
