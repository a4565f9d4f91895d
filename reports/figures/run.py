"""Figures of one run: trajectories, contact, homotopy and gains."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from reports.console import knob_title
from reports.stages import shown
from reports.style import CYCLE, GREY, INK, PLANNED, REPLAYED, WIDTH
from reports.view import RunView

FLOOR = 1e-12
"""What lies below, zero included, is drawn here on log axes."""
_MOST_PANELS = 15
# The plan lies broad and pale under its replay, so that neither hides the other.
_LOOK: tuple[dict[str, Any], ...] = (
    {"color": PLANNED, "linewidth": 2.4, "alpha": 0.5},
    {"color": REPLAYED, "linewidth": 1.0, "linestyle": (0, (4, 2))},
)


def label(name: str, unit: str) -> str:
    """Axis label: a name with its unit in brackets."""
    return f"{name} [{powers(unit)}]" if unit else name


def powers(unit: str) -> str:
    """Write ``m/s^2`` as ``m/s²``."""
    return unit.replace("^2", "²").replace("^3", "³")


def trajectories(view: RunView) -> Figure:
    """Every state, input and contact over time, planned and replayed under the exact law."""
    panels = _panels(view)
    figure, axes = time_panels(len(panels))
    for axis, (name, unit, planned, replayed) in zip(axes, panels, strict=True):
        steps = planned.shape[1] < view.time.size
        for values, look in zip((planned, replayed), _LOOK, strict=True):
            if values is not None:
                _lines(axis, view.time, values, look, steps)
        axis.set_ylabel(label(name, unit))
        _widen(axis)
    handles = [
        Line2D([], [], label="planned", **_LOOK[0]),
        Line2D([], [], label="replayed under the exact law", **_LOOK[1]),
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=2)
    return figure


def _widen(axis: Axes) -> None:
    """Show what hardly moves as a level line, not as noise under an offset."""
    low, high = axis.get_ylim()
    middle = (low + high) / 2
    if high - low < 1e-4 * max(1.0, abs(middle)):
        half = 0.05 * max(1.0, abs(middle))
        axis.set_ylim(middle - half, middle + half)


def time_panels(count: int) -> tuple[Figure, list[Axes]]:
    """Panels over time in two or three columns, the lowest of each column labelled."""
    columns = 2 if count <= 4 else 3
    rows = -(-count // columns)
    figure = Figure(figsize=(WIDTH, 1.15 * rows + 0.5))
    axes = list(figure.subplots(rows, columns, sharex=True, squeeze=False).ravel())
    for axis in axes[count:]:
        axis.set_axis_off()
    for axis in axes[max(0, count - columns) : count]:
        axis.set_xlabel("time [s]")
        axis.tick_params(labelbottom=True)
    return figure, axes[:count]


def _panels(view: RunView) -> list[tuple[str, str, np.ndarray, np.ndarray | None]]:
    found = []
    for kind, name in (("states", "x"), ("inputs", "u"), ("contacts", "lam")):
        values, replayed = view.array(name), view.array(f"{name}_replay")
        if values is None:
            continue
        for index, signal in enumerate(view.signals(kind)):
            text = f"$\\lambda$ {signal.name}" if kind == "contacts" else signal.name
            again = None if replayed is None else replayed[..., index]
            found.append((text, signal.unit, _branch_mean(view, name, values, index), again))
    return found[:_MOST_PANELS]


def _branch_mean(view: RunView, name: str, values: np.ndarray, index: int) -> np.ndarray:
    """One component; a multiplier solved at several noise nodes shows the mean over them."""
    if name != "lam":
        return values[..., index]
    return values[..., index :: len(view.signals("contacts"))].mean(axis=-1)


def _lines(
    axis: Axes, time: np.ndarray, values: np.ndarray, look: dict[str, Any], steps: bool
) -> None:
    if len(values) > 1:
        look = {**look, "linewidth": 0.5 * look["linewidth"]}
    for scenario in values:
        if steps:
            axis.step(time, np.append(scenario, scenario[-1]), where="post", **look)
        else:
            axis.plot(time, scenario, **look)


def contact_plane(view: RunView) -> Figure:
    """Multipliers against gaps on log axes, with the central path ``lam gap = mu``."""
    figure = Figure(figsize=(0.62 * WIDTH, 3.1))
    axis = figure.subplots()
    signals = view.signals("contacts")
    lam, gap, mu = (view.array(name) for name in ("lam", "gap", "mu"))
    assert lam is not None and gap is not None
    again = view.array("lam_replay"), view.array("gap_replay")
    if mu is not None:
        _central_path(axis, mu, gap)
    for index, (title, members) in enumerate(_groups(view).items()):
        own = np.s_[..., np.isin(np.arange(lam.shape[-1]) % len(signals), members)]
        axis.plot(_floored(gap[own]).ravel(), _floored(lam[own]).ravel(), "o", alpha=0.8,
                  color=CYCLE[index % len(CYCLE)], label=f"planned, {title}")  # fmt: skip
    if again[0] is not None and again[1] is not None:
        axis.plot(_floored(again[1]).ravel(), _floored(again[0]).ravel(), "x", color=INK,
                  markersize=3.5, markeredgewidth=0.7, label="replayed, exact law")  # fmt: skip
    gap_unit = view.problem.system.gap_unit if view.problem else "m"
    axis.set(xscale="log", yscale="log")
    axis.set_xlabel(label("gap", gap_unit))
    axis.set_ylabel(label("$\\lambda$", signals[0].unit if signals else ""))
    # Narrower than two decades a log axis has no ticks to read.
    for limits, narrow in ((axis.get_xlim(), axis.set_xlim), (axis.get_ylim(), axis.set_ylim)):
        if limits[1] < 100 * limits[0]:
            narrow(limits[0] / 10, limits[1] * 10)
    for part in (axis.xaxis, axis.yaxis):
        part.set_major_locator(LogLocator(numticks=7))
        part.set_minor_formatter(NullFormatter())
    if min(_floored(lam).min(), _floored(gap).min()) <= FLOOR:
        axis.set_title("points on the lower or left edge are zero", color=GREY, loc="left")
    figure.legend(loc="outside right upper")
    figure.set_figwidth(WIDTH)
    return figure


def _groups(view: RunView) -> dict[str, list[int]]:
    """Title and indices of pairs drawn alike: each its own, or all of a kind if there are kinds."""
    signals = view.signals("contacts")
    pairs = view.problem.system.pairs if view.problem is not None else ()
    if len({pair.kind for pair in pairs}) < 2:
        return {signal.name: [index] for index, signal in enumerate(signals)}
    found: dict[str, list[int]] = {}
    for index, pair in enumerate(pairs):
        found.setdefault(pair.kind, []).append(index)
    return found


def _floored(values: np.ndarray) -> np.ndarray:
    return np.maximum(np.nan_to_num(values), FLOOR)


def _central_path(axis: Axes, mu: np.ndarray, gap: np.ndarray) -> None:
    """Draw ``lam = mu / gap`` around the gaps, at the smallest and the largest mu that occur."""
    present = mu[np.isfinite(mu) & (mu > FLOOR)]
    if not present.size:
        return
    floored = _floored(gap)
    gaps = np.geomspace(floored.min() / 5, floored.max() * 5, 200)
    ends = sorted({float(present.min()), float(present.max())})
    if ends[-1] / ends[0] < 1.001:
        ends = ends[-1:]
    for value, style in zip(ends, ("-", ":"), strict=False):
        axis.plot(gaps, value / gaps, style, color=GREY, linewidth=0.9,
                  label=f"$\\lambda$ gap = {value:.2g}")  # fmt: skip


def homotopy(view: RunView) -> Figure:
    """Cost, complementarity and residual after each stage."""
    numbers, stages = zip(*shown(view.run.stages), strict=True)
    figure = Figure(figsize=(WIDTH, 2.0))
    left, right = figure.subplots(1, 2)
    number = np.array(numbers)
    kept = np.array([stage.accepted for stage in stages])
    cost = np.array([stage.cost for stage in stages], dtype=float)
    left.plot(number[kept], cost[kept], "o-")
    left.plot(number[~kept], cost[~kept], "x", color=REPLAYED)
    left.set_ylabel("cost")
    curves = [
        ("complementarity", CYCLE[0], "max $\\lambda$ gap"),
        ("residual", CYCLE[2], "residual"),
    ]
    knobs = {stage.knob for stage in stages}
    if len(knobs) == 1:
        curves.append(("value", GREY, knob_title(knobs.pop())))
    for name, color, text in curves:
        values = np.array([getattr(stage, name) for stage in stages], dtype=float)
        right.semilogy(number, _floored(values), "o-", color=color, label=text)
    right.set_ylabel("size")
    figure.legend(loc="outside right upper")
    for axis in (left, right):
        axis.set_xlabel("stage")
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    return figure


def gains(view: RunView) -> Figure:
    """Feedback gains K over time as heat maps, one a control."""
    K = view.array("K")
    assert K is not None
    states, inputs = view.signals("states"), view.signals("inputs")
    figure = Figure(figsize=(WIDTH, 0.9 + (0.45 + 0.16 * len(states)) * len(inputs)))
    axes = figure.subplots(len(inputs), 1, sharex=True, squeeze=False)[:, 0]
    # One far outlier must not wash the rest out: the colours end at the 98th percentile.
    limit = float(np.quantile(np.abs(K), 0.98)) or 1.0
    image = None
    for index, axis in enumerate(axes):
        image = axis.pcolormesh(
            np.arange(K.shape[0] + 1) - 0.5, np.arange(len(states) + 1) - 0.5, K[:, index, :].T,
            cmap="PuOr", vmin=-limit, vmax=limit,
        )  # fmt: skip
        axis.set_yticks(range(len(states)), [signal.name for signal in states])
        axis.invert_yaxis()
        axis.grid(False)
        axis.set_ylabel(inputs[index].name)
    axes[-1].set_xlabel("step")
    axes[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    assert image is not None
    bar = figure.colorbar(image, ax=list(axes), extend="both", pad=0.02)
    bar.set_label("K [input unit / state unit]")
    return figure
