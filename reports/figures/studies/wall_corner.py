"""Drawing of study P4."""

from __future__ import annotations

import xarray as xr
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Rectangle
from matplotlib.ticker import NullFormatter

from reports.figures.studies.panels import gradient_panel, unbroken
from reports.style import BLUE, GREEN, GREY, INK, PURPLE, VERMILLION, WIDTH

caption = (
    "Top: throws past the corner of the rectangle (left) and of the dome (right). Middle: minus "
    "the distance over the angle (left); variance of one sample's gradient at the corner's angle "
    "as the dome shrinks (right). Bottom: gradient of the smoothed objective by quadrature (grey) "
    "and estimates, at the rectangle (left) and the dome (right)."
)
_COLORS = (GREEN, PURPLE)


def draw(data: xr.Dataset) -> Figure:
    """Paths, objective, variance, gradients."""
    figure = Figure(figsize=(WIDTH, 6.6))
    paths, (objective, variance), gradients = figure.subplots(3, 2)
    place, width, height = (data.attrs[name] for name in ("place", "width", "height"))
    fine = data["fine"].values
    for index, (color, name) in enumerate(zip(_COLORS, data["shape"].values, strict=True)):
        axis = paths[index]
        axis.add_patch(Rectangle((place - width / 2, 0), width, height, color=GREY, alpha=0.4))
        if index:
            axis.add_patch(Arc((place, height), width, width, theta1=0, theta2=180, color=INK))
        for path in data["path"].values[index]:
            axis.plot(path[:, 0], path[:, 1], color=color, linewidth=0.8)
        axis.set_xlim(1.35, 1.6)
        axis.set_ylim(0.45, 0.55)
        axis.set(xlabel="$x$ [m]", ylabel="$y$ [m]")
        axis.set_title(str(name))
        f = unbroken(data["f"].values[index], 0.05)
        objective.plot(fine, f, color=color, linewidth=2.6 - 1.6 * index, label=str(name))
        gradient, theta = gradients[index], data["theta"].values
        estimates = (data[order][index, :, 0] for order in ("first", "zeroth"))
        gradient_panel(gradient, theta, data["slope"][index], *estimates)
        gradient.set(xlabel="angle $\\theta$ [rad]", ylabel="gradient [m/rad]")
    wide = data["width"].values
    variance.loglog(wide, data["narrow_variance_first"], "o-", color=BLUE, label="FoBG")
    variance.loglog(wide, data["narrow_variance_zeroth"], "s-", color=VERMILLION, label="ZoBG")
    variance.set_xticks(wide[::2], [f"{value:.3g}" for value in wide[::2]])
    for scale in (variance.xaxis, variance.yaxis):
        scale.set_minor_formatter(NullFormatter())
    variance.set(xlabel="diameter of the dome [m]", ylabel="variance [m$^2$/rad$^2$]")
    objective.set(xlabel="angle $\\theta$ [rad]", ylabel="minus distance [m]")
    for axis in (objective, variance, gradients[0]):
        axis.legend()
    return figure
