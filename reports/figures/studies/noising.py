"""Drawings of studies N0 and N1, on noised data and learned contact dynamics [noising]."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from reports.drawing.style import BLUE, CYCLE, FAINT, GREEN, GREY, INK, PURPLE, VERMILLION, WIDTH
from reports.figures.studies.panels import drawing, light_to_dark


@drawing(
    "Lines are theory, marks are computed. Lemma 1: largest distance of g from f_sigma over the "
    "spacing D of uniform data. Lemmas 2 and 3: noised risk of g perturbed by p, above that of g. "
    "Walls: depth at which a penetrating state is predicted, and the slope there, over the "
    "penetration s. Ends: g against f_sigma near the last datum. Networks: distance of h from g over "
    "the number of noised pairs, medians, and the rate -1/2. Neighbours: effective number of data in "
    "an average of g; diamonds: planar-push (7) and planar-hand (11) near the line from start to "
    "goal, at sigma = 0.2 of the deviation, open: data in ranges, filled: half of them near that line."
)
def n0(data: xr.Dataset) -> Figure:
    """Draw study N0 in six panels: lemmas, walls, ends of the data, networks, and effective neighbours."""
    figure = Figure(figsize=(WIDTH, 7.2))
    panels = figure.subplots(3, 2).ravel()
    for axis, panel in zip(panels, (_uniform, _risk, _walls, _ends, _networks, _neighbours), strict=True):
        panel(axis, data)
    return figure


def _uniform(axis: Axes, data: xr.Dataset) -> None:
    spacing = data["spacing"].values
    for start, color, mark in zip(data["place"].values, CYCLE, "os", strict=False):
        law = data["sum_law"].sel(place=start)
        axis.loglog(spacing, law, color=color)
        error = data["sum_error"].sel(place=start).values.reshape(-1, spacing.size)
        kink_place = "at a datum" if start == 0 else "between two"
        axis.plot(spacing, error.T, mark, color=color, markersize=4)
        axis.plot([], [], mark, color=color, label=f"kink {kink_place}", linestyle="-")
    axis.set(title="lemma 1: uniform data", xlabel="$D/\\sigma$", ylabel="$\\max|g_\\sigma - f_\\sigma|/\\rho\\sigma$")
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
    axis.set(
        title="lemmas 2 and 3: least noised risk",
        xlabel="perturbation, root mean square [m]",
        ylabel="risk above that of $g_\\sigma$ [m²]",
    )
    axis.legend(ncols=2, loc="upper center", fontsize=7)


def _walls(axis: Axes, data: xr.Dataset) -> None:
    wall_data = data.isel(gap=-1, width=1)
    depth = wall_data["depth"].values
    fine = np.geomspace(0.1, depth.max(), 200)
    bounds = (np.sqrt(fine**2 + 8) - fine) / 4, (np.sqrt(fine**2 + 4) - fine) / 2
    axis.loglog(fine, np.transpose(bounds), color=BLUE, linewidth=0.8)
    axis.plot(depth[1:], wall_data["inside"][1:], "o", color=BLUE, label="way inside$/\\sigma$, its bounds")
    axis.plot(fine[fine > 3], fine[fine > 3] ** -2, color=VERMILLION, label="$1/s^2$")
    axis.plot(depth[1:], wall_data["slope_outside"][1:], "s", color=VERMILLION, label="slope")
    axis.set(title="block between walls, in penetration", xlabel="penetration $s$ over $\\sigma$")
    axis.legend(loc="lower left")


def _ends(axis: Axes, data: xr.Dataset) -> None:
    distance = data["distance"].values
    upper, lower = (data["bias"].sel(end=end).isel(width=1) for end in ("upper", "lower"))
    axis.axvspan(0, 2, color=GREY, alpha=0.15, linewidth=0, label="within $2\\sigma$")
    axis.plot(distance, upper, color=BLUE, label="pusher in contact")
    axis.plot(distance, lower, color=VERMILLION, label="pusher away")
    axis.set(
        title="ends of uniform data",
        xlabel="distance from the end over $\\sigma$",
        ylabel="$(g_\\sigma - f_\\sigma)/\\rho\\sigma$",
    )
    axis.legend(loc="lower right")


def _networks(axis: Axes, data: xr.Dataset) -> None:
    pairs, units = data["pairs"].values, data["units"].values
    for number, shade in zip(units, light_to_dark(len(units)), strict=True):
        error = data["network_error"].sel(units=number)
        axis.loglog(pairs, error.median("repeat"), color=shade, label=f"2 x {number} units")
        axis.plot(pairs, error, ".", color=shade)
    first = float(data["network_error"][-1, 0].median())
    axis.plot(pairs, first * np.sqrt(pairs[0] / pairs), "--", color=INK, label="rate $-1/2$")
    axis.axhline(float(data["noising_effect"]), color=GREY, linestyle=":", label="$g_\\sigma - f$")
    axis.set_xticks(pairs, [str(n) for n in pairs])
    axis.set_yticks((0.005, 0.01, 0.02, 0.05), ("0.005", "0.01", "0.02", "0.05"))
    axis.minorticks_off()
    axis.set(title="networks on noised pairs", xlabel="noised pairs", ylabel="rms of $h_\\sigma - g_\\sigma$ [m]")
    axis.legend(loc="lower left", fontsize=7)


def _neighbours(axis: Axes, data: xr.Dataset) -> None:
    dims, widths = data["dim"].values, data["normalised"].values
    for width, shade in zip(widths, light_to_dark(len(widths)), strict=True):
        width_data = data.sel(normalised=width)
        axis.semilogy(dims, width_data["neighbours_law"], color=shade)
        axis.plot(dims, width_data["neighbours"], "o", color=shade, label=f"$\\sigma$ = {width:g}")
    task, column = data["task_neighbours"], int(np.argmin(np.abs(widths - 0.2)))
    for sampling, face in zip(data["drawn"].values, ("white", VERMILLION), strict=True):
        axis.plot(
            data["task_size"],
            task.sel(drawn=sampling).isel(normalised=column),
            "D",
            color=VERMILLION,
            markerfacecolor=face,
            label=str(sampling),
        )
    axis.set(
        ylim=(0.6, 2 * float(data.attrs["n_samples"])),
        title="curse of dimension",
        xlabel="dimensions",
        ylabel="effective neighbours",
    )
    axis.legend(fontsize=7)


_WALL_M = 1.0
"""Distance of the walls from the origin [m]."""


@drawing(
    "Left: a pusher is commanded to u, and the block ends at y; f is the exact step, the dots are "
    "Monte Carlo of f_sigma. Right: a block at x between walls at -1 m and 1 m; hatched: "
    "penetration, where there are no data; thin dashed: no motion. Ticks below are the data (of the "
    "dense ones every tenth). Bottom: rollouts of the average and of the network from penetration, "
    "dense data, as cobwebs: up to the map, across to the diagonal, and again."
)
def n1(data: xr.Dataset) -> Figure:
    """Draw study N1: scenes, maps learned from sparse and dense data, and rollouts, of a pusher and of a block."""
    figure = Figure(figsize=(WIDTH, 7.7))
    rows = figure.subplots(4, 2, height_ratios=(0.42, 1, 1, 1))
    _pusher_scene(rows[0, 0])
    _block_scene(rows[0, 1])
    for row, regime in zip(rows[1:3], ("sparse", "dense"), strict=True):
        regime_data = data.sel(regime=regime)
        _pusher(row[0], regime_data, regime)
        _block(row[1], regime_data, regime)
    for axis, name in zip(rows[3], ("g_sigma", "h_sigma"), strict=True):
        _cobweb(axis, data.sel(regime="dense"), name)
    return figure


def _scene(axis: Axes, title: str) -> None:
    axis.set(title=title, aspect="equal")
    axis.axis("off")
    axis.set_ylim(-0.55, 0.85)
    axis.axhline(0, color=GREY, linewidth=0.8)


def _box(axis: Axes, x_low: float, width: float, height: float, color: str, label: str) -> None:
    axis.add_patch(Rectangle((x_low, 0), width, height, facecolor=color, edgecolor=INK, alpha=0.8))
    axis.text(x_low + width / 2, -0.1, label, ha="center", va="top")


def _pusher_scene(axis: Axes) -> None:
    _scene(axis, "pusher and block")
    _box(axis, 0.0, 0.3, 0.45, VERMILLION, "pusher")
    _box(axis, 1.4, 0.7, 0.6, BLUE, "block, $y$")
    axis.annotate("", (1.3, 0.22), (0.35, 0.22), arrowprops={"arrowstyle": "->", "color": INK})
    axis.text(0.84, 0.28, "$u$", ha="center", va="bottom", fontsize=8)
    axis.set_xlim(-0.6, 2.9)


def _block_scene(axis: Axes) -> None:
    _scene(axis, "block between walls")
    for x_low in (-0.5, 2.5):
        axis.add_patch(Rectangle((x_low, -0.02), 0.3, 0.8, facecolor=FAINT, edgecolor=GREY, hatch="///"))
    _box(axis, 0.75, 0.7, 0.6, BLUE, "block, $x$")
    axis.set_xlim(-0.6, 2.9)


def _rms(data: xr.Dataset, name: str) -> str:
    return f"$h_\\sigma$, rms {float(data[name][0]):.1g} m"


def _ticks(axis: Axes, ticks: np.ndarray) -> None:
    shown_places = ticks if ticks.size <= 100 else ticks[::10]
    axis.plot(
        shown_places,
        np.full(shown_places.size, 0.02),
        "|",
        color=INK,
        markersize=6,
        transform=axis.get_xaxis_transform(),
    )


def _pusher(axis: Axes, data: xr.Dataset, regime: str) -> None:
    u = data["u"].values
    axis.plot(u, data["f"], color=INK, linewidth=0.9, label="$f$")
    axis.plot(data["dot"], data["sampled"], "o", color=PURPLE, markersize=3, label="$f_\\sigma$ sampled")
    axis.plot(u, data["pusher_g"], color=BLUE, label="$g_\\sigma$")
    axis.plot(u, data["pusher_h"][0], "--", color=VERMILLION, label=_rms(data, "pusher_rms"))
    axis.set(
        ylim=(-0.15, 1.45),
        title=f"{regime}: {data.sizes[f'pusher_{regime}']} commands",
        xlabel="command $u$ [m]",
        ylabel="block after a step $y$ [m]",
    )
    _ticks(axis, data[f"pusher_data_{regime}"].values)
    axis.legend(loc="upper left")


def _wall_shades(axis: Axes) -> None:
    for low, high in ((-2, -_WALL_M), (_WALL_M, 2)):
        axis.axvspan(low, high, facecolor=FAINT, alpha=0.35, hatch="///", edgecolor=GREY, linewidth=0)
    for side in (-_WALL_M, _WALL_M):
        axis.axhline(side, color=GREY, linewidth=0.7, linestyle=":")
    axis.plot((-2, 2), (-2, 2), "--", color=GREY, linewidth=0.7)
    axis.set_xlim(-2, 2)


def _block(axis: Axes, data: xr.Dataset, regime: str) -> None:
    _wall_shades(axis)
    x = data["x"].values
    if regime == "dense":
        axis.plot(x, data["uniform_block"], color=GREEN, linewidth=2.6, alpha=0.5, label="uniform states")
    axis.plot(x, data["block_g"], color=BLUE, label="$g_\\sigma$")
    axis.plot(x, data["block_h"][0], "--", color=VERMILLION, label=_rms(data, "block_rms"))
    axis.set(
        ylim=(-1.5, 1.5),
        title=f"{regime}: {data.sizes[f'block_{regime}']} states",
        xlabel="block $x$ [m]",
        ylabel="block after a step [m]",
    )
    _ticks(axis, data[f"block_data_{regime}"].values)
    axis.legend(loc="upper left", frameon=True, framealpha=0.9, edgecolor="none")


def _cobweb(axis: Axes, data: xr.Dataset, name: str) -> None:
    _wall_shades(axis)
    average = name == "g_sigma"
    values, color = (data["block_g"], BLUE) if average else (data["block_h"][0], VERMILLION)
    axis.plot(data["x"], values, color=color)
    for path in data["rollout"].sel(map=name).values:
        # The line goes vertically from a state to the map's value, then horizontally to the diagonal: the next state.
        corners = np.repeat(path, 2)
        axis.plot(corners[:-1], np.append(path[0], corners[2:]), color=INK, linewidth=0.8)
        axis.plot(path[0], path[0], "o", color=INK, markersize=3)
    axis.set(
        ylim=(-2, 2),
        title=f"rollouts of ${name[0]}_\\sigma$ from penetration",
        xlabel="block $x$ [m]",
        ylabel="block after a step [m]",
    )
