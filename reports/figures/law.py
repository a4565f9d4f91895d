"""The contact law of a run: on the central path, or at its end as impulses and gaps over time."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from reports.figures.motion import mean_multiplier
from reports.figures.panels import Panel, Row, columns_for, in_rows, lines, note_zero, spans
from reports.style import BLUE, CYCLE, GREEN, GREY, SKY, WIDTH
from reports.units import label
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
