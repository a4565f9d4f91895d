"""Drawing of study A2."""

from __future__ import annotations

import xarray as xr
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from reports.figures.studies.panels import impulse_arrow, light_to_dark
from reports.style import INK, WIDTH

caption = (
    "Height, vertical velocity and its derivative along the horizontal position. Top: the "
    "softened equation of motion (C.1), which is elastic. Bottom: time stepping, softened (lines) "
    "and exact (dashed), which is plastic; the arrow stands for the impulse."
)


def draw(data: xr.Dataset) -> Figure:
    """Two rows, one a model; three columns."""
    figure = Figure(figsize=(WIDTH, 4.6))
    axes = figure.subplots(2, 3, sharex=True)
    mus = data["mu"].values
    shades = light_to_dark(len(mus))
    rows = (
        (axes[0], ("y", "v", "rate"), ("q_x", "q_x", "q_x")),
        (axes[1], ("y_step", "v_step", "rate_step"), ("q_step", "q_step", "q_mid")),
    )
    for row, names, places in rows:
        for axis, name, place in zip(row, names, places, strict=True):
            for index, shade in enumerate(shades):
                axis.plot(data[place], data[name][index], color=shade)
    for axis, name, place in zip(
        axes[1], ("y_exact", "v_exact", "rate_exact"), rows[1][2], strict=True
    ):
        axis.plot(data[place], data[name], "--", color=INK, linewidth=1.0)
    spike = data["rate_exact"].values
    where = float(data["q_mid"][int(spike.argmax())])
    impulse_arrow(axes[1, 2], where, spike.max(), spike.max() * 4)
    for row in axes:
        for axis, text in zip(row, ("$y$ [m]", "$v_y$ [m/s]", "$dv_y/dq_x$ [1/s]"), strict=True):
            axis.set_ylabel(text)
        row[2].set_yscale("symlog", linthresh=10)
    axes[1, 2].set_ylim(top=spike.max() * 6)
    for axis in axes[1]:
        axis.set_xlabel("$q_x$ [m]")
    handles = [Line2D([], [], color=shade) for shade in shades]
    labels = [f"$\\mu$ = {mu:g} J/kg" for mu in mus]
    handles.append(Line2D([], [], color=INK, linestyle="--"))
    figure.legend(handles, [*labels, "exact law"], loc="outside upper center", ncols=5)
    return figure
