"""Drawing of study N0."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.figures.studies.panels import Drawing, light_to_dark
from reports.style import BLUE, CYCLE, GREY, INK, VERMILLION, WIDTH


def _draw(data: xr.Dataset) -> Figure:
    """Six panels: lemmas, walls, ends, networks and neighbours."""
    figure = Figure(figsize=(WIDTH, 7.2))
    panels = figure.subplots(3, 2).ravel()
    for axis, panel in zip(
        panels, (_uniform, _risk, _walls, _ends, _networks, _neighbours), strict=True
    ):
        panel(axis, data)
    return figure


def _uniform(axis: Axes, data: xr.Dataset) -> None:
    spacing = data["spacing"].values
    for place, color, mark in zip(data["place"].values, CYCLE, "os", strict=False):
        law = data["sum_law"].sel(place=place)
        axis.loglog(spacing, law, color=color)
        error = data["sum_error"].sel(place=place).values.reshape(-1, spacing.size)
        where = "at a datum" if place == 0 else "between two"
        axis.plot(spacing, error.T, mark, color=color, markersize=4)
        axis.plot([], [], mark, color=color, label=f"kink {where}", linestyle="-")
    axis.set(title="lemma 1: uniform data", xlabel="$D/\\sigma$",
             ylabel="$\\max|g_\\sigma - f_\\sigma|/\\rho\\sigma$")  # fmt: skip
    axis.set_xticks(spacing, [f"{value:g}" for value in spacing])
    axis.minorticks_off()
    axis.legend()


def _risk(axis: Axes, data: xr.Dataset) -> None:
    change, width = data["change"].values, data["width"].values[1]
    for case, color, mark in zip(data["case"].values, CYCLE, "os^Dv", strict=False):
        mean = data["higher"].sel(case=case, width=width).mean("perturbation")
        axis.plot(change, mean, mark, color=color, label=str(case), fillstyle="none")
    fine = np.linspace(change.min(), change.max(), 101)
    axis.plot(fine, fine**2, color=INK, zorder=0, label="$E\\,p^2$")
    axis.set(title="lemmas 2 and 3: least noised risk", xlabel="perturbation, root mean square [m]",
             ylabel="risk above that of $g_\\sigma$ [m²]")  # fmt: skip
    axis.legend(ncols=2, loc="upper center", fontsize=7)


def _walls(axis: Axes, data: xr.Dataset) -> None:
    at = data.isel(gap=-1, width=1)
    depth = at["depth"].values
    fine = np.geomspace(0.1, depth.max(), 200)
    bounds = (np.sqrt(fine**2 + 8) - fine) / 4, (np.sqrt(fine**2 + 4) - fine) / 2
    axis.loglog(fine, np.transpose(bounds), color=BLUE, linewidth=0.8)
    axis.plot(
        depth[1:], at["inside"][1:], "o", color=BLUE, label="way inside$/\\sigma$, its bounds"
    )
    axis.plot(fine[fine > 3], fine[fine > 3] ** -2, color=VERMILLION, label="$1/s^2$")
    axis.plot(depth[1:], at["slope_outside"][1:], "s", color=VERMILLION, label="slope")
    axis.set(title="block between walls, in penetration", xlabel="penetration $s$ over $\\sigma$")
    axis.legend(loc="lower left")


def _ends(axis: Axes, data: xr.Dataset) -> None:
    distance = data["distance"].values
    upper, lower = (data["bias"].sel(end=end).isel(width=1) for end in ("upper", "lower"))
    axis.axvspan(0, 2, color=GREY, alpha=0.15, linewidth=0, label="within $2\\sigma$")
    axis.plot(distance, upper, color=BLUE, label="pusher in contact")
    axis.plot(distance, lower, color=VERMILLION, label="pusher away")
    axis.set(title="ends of uniform data", xlabel="distance from the end over $\\sigma$",
             ylabel="$(g_\\sigma - f_\\sigma)/\\rho\\sigma$")  # fmt: skip
    axis.legend(loc="lower right")


def _networks(axis: Axes, data: xr.Dataset) -> None:
    pairs, units = data["pairs"].values, data["units"].values
    for number, shade in zip(units, light_to_dark(len(units)), strict=True):
        error = data["network_error"].sel(units=number)
        axis.loglog(pairs, error.median("repeat"), color=shade,
                    label=f"2 x {number} units")  # fmt: skip
        axis.plot(pairs, error, ".", color=shade)
    first = float(data["network_error"][-1, 0].median())
    axis.plot(pairs, first * np.sqrt(pairs[0] / pairs), "--", color=INK, label="rate $-1/2$")
    axis.axhline(float(data["noising_effect"]), color=GREY, linestyle=":", label="$g_\\sigma - f$")
    axis.set_xticks(pairs, [str(n) for n in pairs])
    axis.set_yticks((0.005, 0.01, 0.02, 0.05), ("0.005", "0.01", "0.02", "0.05"))
    axis.minorticks_off()
    axis.set(title="networks on noised pairs", xlabel="noised pairs",
             ylabel="rms of $h_\\sigma - g_\\sigma$ [m]")  # fmt: skip
    axis.legend(loc="lower left", fontsize=7)


def _neighbours(axis: Axes, data: xr.Dataset) -> None:
    dims, widths = data["dim"].values, data["normalised"].values
    for width, shade in zip(widths, light_to_dark(len(widths)), strict=True):
        at = data.sel(normalised=width)
        axis.semilogy(dims, at["neighbours_law"], color=shade)
        axis.plot(dims, at["neighbours"], "o", color=shade, label=f"$\\sigma$ = {width:g}")
    task, column = data["task_neighbours"], int(np.argmin(np.abs(widths - 0.2)))
    for drawn, face in zip(data["drawn"].values, ("white", VERMILLION), strict=True):
        axis.plot(data["task_size"], task.sel(drawn=drawn).isel(normalised=column), "D",
                  color=VERMILLION, markerfacecolor=face, label=str(drawn))  # fmt: skip
    axis.set(ylim=(0.6, 2 * float(data.attrs["n_samples"])), title="curse of dimension",
             xlabel="dimensions", ylabel="effective neighbours")  # fmt: skip
    axis.legend(fontsize=7)


DRAWING = Drawing(
    _draw,
    "Lines: theory, marks: computed. Lemma 1: largest distance of g from f_sigma over the spacing "
    "D of uniform data. Lemmas 2 and 3: noised risk of g perturbed by p, above that of g. Walls: "
    "how far inside a penetrating state is put, and the slope there, over the penetration s. Ends: "
    "g against f_sigma near the last datum. Networks: distance of h from g over the number of "
    "noised pairs, medians, and the rate -1/2. Neighbours: effective number of data in an average "
    "of g; diamonds: planar-push (7) and planar-hand (11) in the tube, at sigma = 0.2 of the "
    "deviation, open: data in ranges, filled: half of them in the tube.",
)
