"""Figures of one run: its contact law, its contacts, its homotopy, and its feedback gains."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from reports.console import shown_stages, stage_title
from reports.figures.motion import mean_multiplier
from reports.figures.panels import (
    Panel,
    Row,
    between,
    columns_for,
    in_rows,
    lines,
    note_zero,
    spans,
)
from reports.notation import label, symbol
from reports.style import (
    BLUE,
    CYCLE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    REPLAYED,
    SKY,
    VERMILLION,
    WIDTH,
)
from reports.view import RunView

FLOOR = 1e-12
"""What lies below, zero included, is no number for a log axis and is not drawn."""
_ACTS = 1e-6
"""Share of the largest multiplier in the same unit above which a pair is in contact."""


def at_the_end(view: RunView) -> bool:
    """Whether the run's law is complementarity itself, mu = 0 throughout."""
    mu = view.array("mu")
    return mu is not None and bool(np.all(mu == 0))


def contact_plane(view: RunView) -> Figure:
    """Multipliers of the plan against gaps on log axes, with the central path ``lam gap = mu``."""
    figure = Figure(figsize=(WIDTH, 2.9))
    axis = figure.subplots()
    signals = view.signals("contacts")
    lam, gap, mu = (view.array(name) for name in ("lam", "gap", "mu"))
    assert lam is not None and gap is not None
    if mu is not None:
        _central_path(axis, mu, gap)
    for index, (title, members) in enumerate(groups(view).items()):
        own = np.s_[..., np.isin(np.arange(lam.shape[-1]) % len(signals), members)]
        axis.plot(_above(gap[own]).ravel(), _above(lam[own]).ravel(), "os^Dv"[index % 5], alpha=0.8,
                  color=CYCLE[index % len(CYCLE)], label=title)  # fmt: skip
    gap_unit = view.gap_unit
    axis.set(xscale="log", yscale="log", xlabel=label("gap", gap_unit),
             ylabel=label("λ", signals[0].unit if signals else ""))  # fmt: skip
    _readable(axis)
    missing = int(np.sum((lam <= FLOOR) | (gap <= FLOOR)))
    if missing:
        axis.set_title(f"{missing} of {lam.size} points have a λ or a gap below {FLOOR:.0e} and"
                       " are not drawn", color=GREY, loc="left")  # fmt: skip
    figure.legend(loc="outside right upper")
    return figure


def _readable(axis: Axes) -> None:
    """Narrower than two decades a log axis has no ticks to read."""
    for limits, narrow in ((axis.get_xlim(), axis.set_xlim), (axis.get_ylim(), axis.set_ylim)):
        if limits[1] < 100 * limits[0]:
            narrow(limits[0] / 10, limits[1] * 10)
    for part in (axis.xaxis, axis.yaxis):
        part.set_major_locator(LogLocator(numticks=7))
        part.set_minor_formatter(NullFormatter())


def groups(view: RunView) -> dict[str, list[int]]:
    """Title and indices of pairs drawn alike: each its own, or all of a kind if there are kinds."""
    signals = view.signals("contacts")
    pairs = view.problem.system.pairs if view.problem is not None else ()
    if len({pair.kind for pair in pairs}) < 2:
        return {signal.name: [index] for index, signal in enumerate(signals)}
    found: dict[str, list[int]] = {}
    for index, pair in enumerate(pairs):
        found.setdefault(pair.kind, []).append(index)
    return found


def _above(values: np.ndarray) -> np.ndarray:
    return np.where(values > FLOOR, values, np.nan)


def _central_path(axis: Axes, mu: np.ndarray, gap: np.ndarray) -> None:
    """Draw ``lam = mu / gap`` around the gaps, at the smallest and the largest mu that occur."""
    present, seen = mu[np.isfinite(mu) & (mu > FLOOR)], gap[gap > FLOOR]
    if not (present.size and seen.size):
        return
    gaps = np.geomspace(seen.min() / 5, seen.max() * 5, 200)
    ends = sorted({float(present.min()), float(present.max())})
    if ends[-1] / ends[0] < 1.001:
        ends = ends[-1:]
    for value, style in zip(ends, ("-", ":"), strict=False):
        axis.plot(gaps, value / gaps, style, color=GREY, linewidth=0.9,
                  label=f"λ gap = {value:.2g}")  # fmt: skip


def interval_rows(view: RunView) -> tuple[list[Row], int, list[str]]:
    """Multiplier above, gap below, over time, for every contact that acts.

    Rows, their number of columns, and the names of the contacts that never act. Contacts are pairs
    of the normal kind, or all where there are none. Contact is shaded, of several scenarios the
    darker the more of them are in contact.
    """
    signals = view.signals("contacts")
    lam, gap = view.array("lam"), view.array("gap")
    assert lam is not None and gap is not None
    pairs = view.problem.system.pairs if view.problem is not None else ()
    normal = [i for i, pair in enumerate(pairs) if pair.kind == "normal"]
    panels, resting = list[Panel](), list[str]()
    reach = float(np.max(gap, initial=0.0))
    for index in normal or range(len(signals)):
        pushed, way = (mean_multiplier(view, values, index) for values in (lam, gap))
        alike = [i for i, signal in enumerate(signals) if signal.unit == signals[index].unit]
        largest = max(np.max(mean_multiplier(view, lam, i), initial=0.0) for i in alike)
        touching = pushed > _ACTS * largest
        if not touching.any():
            resting.append(signals[index].name)
            continue
        title = label(signals[index].name, signals[index].unit)
        panels.append(_interval(view.time, title, reach, (pushed, way, touching)))
    columns = columns_for(len(panels))
    return in_rows({"": panels}, columns), columns, resting


def _interval(
    time: np.ndarray, title: str, reach: float, data: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> Panel:
    pushed, way, touching = data
    look = {"linewidth": 1.2 if len(pushed) == 1 else 0.5}

    def shade(axis: Axes) -> None:
        for scenario in touching:
            spans(axis, time, scenario, facecolor=SKY, alpha=0.3 / len(touching), linewidth=0)

    def main(axis: Axes) -> None:
        shade(axis)
        lines(axis, time, pushed, color=BLUE, **look)

    def below(axis: Axes) -> None:
        shade(axis)
        note_zero(axis)
        lines(axis, time, way, color=GREEN, **look)
        if reach > 0 and np.max(way) < _ACTS * reach:
            # A gap that never opens: to its own scale it would be noise.
            axis.set_ylim(-0.05 * reach, reach)

    return Panel(title, main, below)


_CONE: dict[str, Any] = {"facecolor": PURPLE, "alpha": 0.3}
_SLIP: dict[str, Any] = {"facecolor": ORANGE, "alpha": 0.25, "linewidth": 0}
_STICK: dict[str, Any] = {"facecolor": SKY, "alpha": 0.2, "linewidth": 0}
_DEGENERATE: dict[str, Any] = {"color": INK, "marker": "v", "markersize": 3.5, "linestyle": ""}


def friction_rows(view: RunView) -> tuple[list[Row], int]:
    """Normal and friction impulse [N s] of every contact that acts, in all scenarios of the plan.

    The band is what friction can hold, +-friction times the normal impulse; steps at which the
    contact slips or sticks are shaded, the paler the fewer scenarios do, and steps at which
    complementarity is not strict marked. Comes with the number of columns; there are no rows for a
    run without friction or contact.
    """
    if view.array("friction_bound") is None:
        return [], 1
    acting = np.flatnonzero((_all(view, "active") > 0.5).any(axis=(0, 1)))
    names = [str(name) for name in view.run.data["point"].values]
    panels = [_friction_panel(view, names[i], int(i)) for i in acting]
    columns = columns_for(len(panels))
    return in_rows({"Contacts [N s]": panels}, columns), columns


def _friction_panel(view: RunView, name: str, i: int) -> Panel:
    flags = ("active", "slipping", "degenerate")
    active, slips, degenerate = (_all(view, flag)[..., i] > 0.5 for flag in flags)
    normal, friction, bound = (
        _all(view, kind)[..., i]
        for kind in ("normal_impulse", "friction_impulse", "friction_bound")
    )
    width = {"linewidth": 1.2 if len(normal) == 1 else 0.5}

    def main(axis: Axes) -> None:
        share = 1 / len(normal)
        for slipping, touching, most in zip(slips, active, bound, strict=True):
            _shade(axis, view.time, slipping, _SLIP, share)
            _shade(axis, view.time, touching & ~slipping, _STICK, share)
            between(axis, view.time, -most, most, **{**_CONE, "alpha": _CONE["alpha"] * share})
        note_zero(axis)
        lines(axis, view.time, normal, color=BLUE, **width)
        lines(axis, view.time, friction, color=VERMILLION, **width)
        middle = (view.time[:-1] + view.time[1:]) / 2
        place = middle[degenerate.any(axis=0)]
        axis.plot(place, np.zeros_like(place), **_DEGENERATE)

    return Panel(f"{name} [N s]", main)


def _all(view: RunView, name: str) -> np.ndarray:
    """A stored array of all scenarios, (S, N, points)."""
    values = view.array(name)
    assert values is not None
    return values


def _shade(
    axis: Axes, time: np.ndarray, when: np.ndarray, look: dict[str, Any], share: float
) -> None:
    spans(axis, time, when, **{**look, "alpha": look["alpha"] * share})


def homotopy(view: RunView) -> Figure:
    """Cost, complementarity and residual after each stage; what is zero is not drawn."""
    numbers, stages = zip(*shown_stages(view.run.stages, view.run.meta["cost"])[0], strict=True)
    figure = Figure(figsize=(WIDTH, 1.9))
    left, right = figure.subplots(1, 2)
    number = np.array(numbers)
    kept = np.array([stage.accepted for stage in stages])
    cost = np.array([stage.cost for stage in stages], dtype=float)
    left.plot(number[kept], cost[kept], "o-")
    left.plot(number[~kept], cost[~kept], "x", color=REPLAYED, label="stepped back")
    left.set_ylabel("cost")
    curves = [
        ("complementarity", CYCLE[0], "largest λ gap"),
        ("residual", CYCLE[2], "residual"),
    ]
    labels = {stage.label for stage in stages}
    if len(labels) == 1:
        curves.append(("value", GREY, symbol(stage_title(labels.pop()))))
    for name, color, text in curves:
        values = np.array([getattr(stage, name) for stage in stages], dtype=float)
        seen = values > 0
        right.semilogy(number[seen], values[seen], "o-", color=color, label=text)
    right.set_ylabel("size")
    figure.legend(*right.get_legend_handles_labels(), loc="outside right upper")
    if not kept.all():
        left.legend()
    for axis in (left, right):
        axis.set(xlabel="stage", xlim=(number[0] - 0.5, number[-1] + 0.5))
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
