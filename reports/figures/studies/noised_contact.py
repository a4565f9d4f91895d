"""Drawing of study N1."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from reports.figures.studies.panels import Drawing
from reports.style import BLUE, FAINT, GREEN, GREY, INK, PURPLE, VERMILLION, WIDTH

_EDGE = 1.0


def _draw(data: xr.Dataset) -> Figure:
    """Rows: what is learned, sparse data, dense data, rollouts; pusher left, block right."""
    figure = Figure(figsize=(WIDTH, 7.7))
    rows = figure.subplots(4, 2, height_ratios=(0.42, 1, 1, 1))
    _pusher_scene(rows[0, 0])
    _block_scene(rows[0, 1])
    for row, regime in zip(rows[1:3], ("sparse", "dense"), strict=True):
        at = data.sel(regime=regime)
        _pusher(row[0], at, regime)
        _block(row[1], at, regime)
    for axis, name in zip(rows[3], ("g_sigma", "h_sigma"), strict=True):
        _cobweb(axis, data.sel(regime="dense"), name)
    return figure


def _scene(axis: Axes, title: str) -> None:
    axis.set(title=title, aspect="equal")
    axis.axis("off")
    axis.set_ylim(-0.55, 0.85)
    axis.axhline(0, color=GREY, linewidth=0.8)


def _box(axis: Axes, left: float, width: float, height: float, color: str, label: str) -> None:
    axis.add_patch(Rectangle((left, 0), width, height, facecolor=color, edgecolor=INK, alpha=0.8))
    axis.text(left + width / 2, -0.1, label, ha="center", va="top")


def _pusher_scene(axis: Axes) -> None:
    _scene(axis, "pusher and block")
    _box(axis, 0.0, 0.3, 0.45, VERMILLION, "pusher")
    _box(axis, 1.4, 0.7, 0.6, BLUE, "block, $y$")
    axis.annotate("", (1.3, 0.22), (0.35, 0.22), arrowprops={"arrowstyle": "->", "color": INK})
    axis.text(0.84, 0.28, "$u$", ha="center", va="bottom", fontsize=8)
    axis.set_xlim(-0.6, 2.9)


def _block_scene(axis: Axes) -> None:
    _scene(axis, "block between walls")
    for left in (-0.5, 2.5):
        axis.add_patch(Rectangle((left, -0.02), 0.3, 0.8, facecolor=FAINT, edgecolor=GREY,
                                 hatch="///"))  # fmt: skip
    _box(axis, 0.75, 0.7, 0.6, BLUE, "block, $x$")
    axis.set_xlim(-0.6, 2.9)


def _rms(at: xr.Dataset, name: str) -> str:
    return f"$h_\\sigma$, rms {float(at[name][0]):.1g} m"


def _ticks(axis: Axes, places: np.ndarray) -> None:
    some = places if places.size <= 100 else places[::10]
    axis.plot(some, np.full(some.size, 0.02), "|", color=INK, markersize=6,
              transform=axis.get_xaxis_transform())  # fmt: skip


def _pusher(axis: Axes, at: xr.Dataset, regime: str) -> None:
    u = at["u"].values
    axis.plot(u, at["f"], color=INK, linewidth=0.9, label="$f$")
    axis.plot(
        at["dot"], at["sampled"], "o", color=PURPLE, markersize=3, label="$f_\\sigma$ sampled"
    )
    axis.plot(u, at["pusher_g"], color=BLUE, label="$g_\\sigma$")
    axis.plot(u, at["pusher_h"][0], "--", color=VERMILLION, label=_rms(at, "pusher_rms"))
    axis.set(ylim=(-0.15, 1.45), title=f"{regime}: {at.sizes[f'pusher_{regime}']} commands",
             xlabel="command $u$ [m]", ylabel="block after a step $y$ [m]")  # fmt: skip
    _ticks(axis, at[f"pusher_data_{regime}"].values)
    axis.legend(loc="upper left")


def _walls(axis: Axes) -> None:
    for low, high in ((-2, -_EDGE), (_EDGE, 2)):
        axis.axvspan(low, high, facecolor=FAINT, alpha=0.35, hatch="///", edgecolor=GREY,
                     linewidth=0)  # fmt: skip
    for side in (-_EDGE, _EDGE):
        axis.axhline(side, color=GREY, linewidth=0.7, linestyle=":")
    axis.plot((-2, 2), (-2, 2), "--", color=GREY, linewidth=0.7)
    axis.set_xlim(-2, 2)


def _block(axis: Axes, at: xr.Dataset, regime: str) -> None:
    _walls(axis)
    x = at["x"].values
    if regime == "dense":
        axis.plot(x, at["uniform_block"], color=GREEN, linewidth=2.6, alpha=0.5,
                  label="uniform states")  # fmt: skip
    axis.plot(x, at["block_g"], color=BLUE, label="$g_\\sigma$")
    axis.plot(x, at["block_h"][0], "--", color=VERMILLION, label=_rms(at, "block_rms"))
    axis.set(ylim=(-1.5, 1.5), title=f"{regime}: {at.sizes[f'block_{regime}']} states",
             xlabel="block $x$ [m]", ylabel="block after a step [m]")  # fmt: skip
    _ticks(axis, at[f"block_data_{regime}"].values)
    axis.legend(loc="upper left", frameon=True, framealpha=0.9, edgecolor="none")


def _cobweb(axis: Axes, at: xr.Dataset, name: str) -> None:
    _walls(axis)
    average = name == "g_sigma"
    values, color = (at["block_g"], BLUE) if average else (at["block_h"][0], VERMILLION)
    axis.plot(at["x"], values, color=color)
    for path in at["rollout"].sel(map=name).values:
        # Over each state to the map's value, then level to the diagonal, where the next begins.
        corners = np.repeat(path, 2)
        axis.plot(corners[:-1], np.append(path[0], corners[2:]), color=INK, linewidth=0.8)
        axis.plot(path[0], path[0], "o", color=INK, markersize=3)
    axis.set(ylim=(-2, 2), title=f"rollouts of ${name[0]}_\\sigma$ from penetration",
             xlabel="block $x$ [m]", ylabel="block after a step [m]")  # fmt: skip


DRAWING = Drawing(
    _draw,
    "Left: a pusher is sent to u, and the block is found at y; f is the exact step, the dots are "
    "Monte Carlo of f_sigma. Right: a block at x between walls at -1 m and 1 m; hatched: "
    "penetration, where no data are; thin dashed: no motion. Ticks below: the data (of the dense "
    "ones every tenth). Bottom: rollouts of the average and of the network from penetration, "
    "dense data, as cobwebs: up to the map, across to the diagonal, and again.",
)
