"""Figures of one solve: contact law, contacts, homotopy stages, compared solutions, and feedback gains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from dynamics.systems.pairs import Pair
from ocp.judge.contact_report import active_contacts
from reports.drawing.notation import label, symbol
from reports.drawing.style import BLUE, CYCLE, GREEN, GREY, INK, ORANGE, PURPLE, REPLAYED, SKY, VERMILLION, WIDTH
from reports.drawing.view import RunView
from reports.figures.panels import (
    Panel,
    Row,
    columns_for,
    draw_lines,
    fill_band,
    lay_out_rows,
    note_zero,
    shade_spans,
    use_log_if_wide,
)
from reports.figures.trajectories import NEGLIGIBLE, SAME, mean_multiplier
from reports.tables.console import shown_stages, stage_title

FLOOR = 1e-12
"""Smallest multiplier or gap that is drawn on a log axis; smaller values are zero up to rounding errors."""


def is_before_path_end(view: RunView) -> bool:
    """Return whether mu is nonzero somewhere, and some contact has a multiplier and a gap to draw."""
    lam, gap, mu = (view.array(name) for name in ("lam", "gap", "mu"))
    if lam is None or gap is None or mu is None or not np.isfinite(mu).any():
        return False
    return bool(np.any(mu != 0) and np.any((lam > FLOOR) & (gap > FLOOR)))


def contact_plane(view: RunView) -> Figure:
    """Draw multipliers of the plan over gaps on log axes, with the central path ``lam gap = mu``."""
    figure = Figure(figsize=(WIDTH, 2.4))
    axis = figure.subplots()
    signals = view.signals("contacts")
    lam, gap, mu = (view.array(name) for name in ("lam", "gap", "mu"))
    assert lam is not None and gap is not None
    if mu is not None:
        _central_path(axis, mu, gap)
    for index, (title, members) in enumerate(pair_groups(view).items()):
        members_index = np.s_[..., np.isin(np.arange(lam.shape[-1]) % len(signals), members)]
        axis.plot(
            _above(gap[members_index]).ravel(),
            _above(lam[members_index]).ravel(),
            "os^Dv"[index % 5],
            alpha=0.8,
            color=CYCLE[index % len(CYCLE)],
            label=title,
        )
    gap_unit = view.gap_unit
    axis.set(
        xscale="log", yscale="log", xlabel=label("gap", gap_unit), ylabel=label("λ", signals[0].unit if signals else "")
    )
    _widen_log_axes(axis)
    missing = int(np.sum((lam <= FLOOR) | (gap <= FLOOR)))
    if missing:
        axis.set_title(
            f"{missing} of {lam.size} points have a λ or a gap below {FLOOR:.0e} and are not drawn",
            color=GREY,
            loc="left",
        )
    figure.legend(loc="outside right upper")
    return figure


def _widen_log_axes(axis: Axes) -> None:
    """Widen log axes of less than two decades, which would have no readable ticks."""
    for limits, set_limits in ((axis.get_xlim(), axis.set_xlim), (axis.get_ylim(), axis.set_ylim)):
        if limits[1] < 100 * limits[0]:
            set_limits(limits[0] / 10, limits[1] * 10)
    for axis_line in (axis.xaxis, axis.yaxis):
        axis_line.set_major_locator(LogLocator(numticks=7))
        axis_line.set_minor_formatter(NullFormatter())


def pair_groups(view: RunView) -> dict[str, list[int]]:
    """Return a mapping from titles to indices of pairs drawn in one style: all pairs of a kind, or single pairs."""
    signals = view.signals("contacts")
    pairs = view.problem.system.pairs if view.problem is not None else ()
    if len({pair.kind for pair in pairs}) < 2:
        return {signal.name: [index] for index, signal in enumerate(signals)}
    indices_by_kind: dict[str, list[int]] = {}
    for index, pair in enumerate(pairs):
        indices_by_kind.setdefault(pair.kind, []).append(index)
    return indices_by_kind


def _above(values: np.ndarray) -> np.ndarray:
    return np.where(values > FLOOR, values, np.nan)


def _central_path(axis: Axes, mu: np.ndarray, gap: np.ndarray) -> None:
    """Draw ``lam = mu / gap`` around the gaps, for the smallest and the largest mu of the run."""
    visible_mu, visible_gaps = mu[np.isfinite(mu) & (mu > FLOOR)], gap[gap > FLOOR]
    if not (visible_mu.size and visible_gaps.size):
        return
    gaps = np.geomspace(visible_gaps.min() / 5, visible_gaps.max() * 5, 200)
    ends = sorted({float(visible_mu.min()), float(visible_mu.max())})
    if ends[-1] / ends[0] < 1.001:
        ends = ends[-1:]
    for value, style in zip(ends, ("-", ":"), strict=False):
        axis.plot(gaps, value / gaps, style, color=GREY, linewidth=0.9, label=f"λ gap = {value:.2g}")


@dataclass(frozen=True)
class ContactTrace:
    """One contact over the steps of all scenarios, as arrays (S, N).

    ``normal`` is the normal impulse or force, ``replay`` the same in the replay (None without a replay),
    ``gap`` the gap, None if unknown; ``active`` comes from :func:`ocp.judge.contact_report.active_contacts`.
    ``friction`` contains the friction, its bound, and masks of slip and of degeneracy; it is empty without friction.
    ``multipliers`` are the names of the multipliers that the trace shows.
    """

    title: str
    normal: np.ndarray
    replay: np.ndarray | None
    gap: np.ndarray | None
    active: np.ndarray
    friction: tuple[np.ndarray, ...] = ()
    multipliers: tuple[str, ...] = ()


def contacts_of(view: RunView) -> list[ContactTrace]:
    """Return a trace of each contact of a run, in the order of its table; none for a run without multipliers."""
    lam, signals = view.array("lam"), view.signals("contacts")
    if lam is None:
        return []
    pairs = view.problem.system.pairs if view.problem is not None else ()
    if view.array("friction_bound") is not None:
        return [_frictional_trace(view, i, pairs) for i in range(view.run.data.sizes["point"])]
    gap, replayed = view.array("gap"), view.array("lam_replay")
    assert gap is not None
    if replayed is not None and replayed.shape[:2] != lam.shape[:2]:
        replayed = None
    multipliers = [mean_multiplier(view, lam, i) for i in range(len(signals))]
    gaps = [mean_multiplier(view, gap, i) for i in range(len(signals))]
    scales = getattr(view.problem, "scales", None)
    # For an unknown problem the largest values of the run replace the characteristic sizes.
    sizes = [max((float(values.max()) for values in group), default=0.0) or 1.0 for group in (multipliers, gaps)]
    if scales is not None:
        sizes = [scales.impulse, scales.gap]
    return [
        ContactTrace(
            label(signal.name, signal.unit),
            multipliers[i],
            None if replayed is None else mean_multiplier(view, replayed, i),
            gaps[i],
            active_contacts(multipliers[i] / sizes[0], gaps[i] / sizes[1])[0],
            multipliers=(signal.name,),
        )
        for i, signal in enumerate(signals)
    ]


def _frictional_trace(view: RunView, point: int, pairs: Sequence[Pair]) -> ContactTrace:
    """Return the trace of a contact with friction, from the stored arrays of the run."""
    pair_indices = [i for i, pair in enumerate(pairs) if pair.contact == point and pair.kind in ("normal", "friction")]
    normal = next((i for i in pair_indices if pairs[i].kind == "normal"), None)
    gap, signals = view.array("gap"), view.signals("contacts")

    def stored(name: str) -> np.ndarray:
        values = view.array(name)
        assert values is not None
        return values[..., point]

    flags = (stored("slipping") > 0.5, stored("degenerate") > 0.5)
    replayed = view.array("normal_impulse_replay")
    return ContactTrace(
        label(str(view.run.data["point"].values[point]), "N s"),
        stored("normal_impulse"),
        None if replayed is None or replayed.shape[:2] != flags[0].shape else replayed[..., point],
        None if gap is None or normal is None else mean_multiplier(view, gap, normal),
        stored("active") > 0.5,
        (stored("friction_impulse"), stored("friction_bound"), *flags),
        tuple(signals[i].name for i in pair_indices),
    )


_CONE_STYLE: dict[str, Any] = {"facecolor": PURPLE, "alpha": 0.3}
"""Style of the band that friction cannot leave."""
_SLIP_STYLE: dict[str, Any] = {"facecolor": ORANGE, "alpha": 0.25, "linewidth": 0}
"""Style of the steps at which a contact slips."""
_STICK_STYLE: dict[str, Any] = {"facecolor": SKY, "alpha": 0.3, "linewidth": 0}
"""Style of the steps at which a contact sticks."""
_DEGENERATE_STYLE: dict[str, Any] = {"color": INK, "marker": "v", "markersize": 3.5, "linestyle": ""}
"""Style of the marks at steps without strict complementarity."""


def rows_of_contacts(view: RunView) -> tuple[list[Row], int]:
    """Return panels of impulse and gap over time for every contact with a force, and the number of columns.

    For a contact with friction a panel also shows the friction impulse, in the band between plus and minus the
    friction coefficient times the normal impulse. Steps at which the contact sticks or slips are shaded in two
    colours, darker for more scenarios; steps without strict complementarity are marked. If the replay
    differs from the plan, it is drawn dashed.
    """
    contacts = contacts_of(view)
    largest_normal = max((float(contact.normal.max()) for contact in contacts), default=0.0)
    contacts = [
        contact for contact in contacts if contact.active.any() or contact.normal.max() > NEGLIGIBLE * largest_normal
    ]
    largest_gap = max((float(contact.gap.max()) for contact in contacts if contact.gap is not None), default=0.0)
    columns = columns_for(len(contacts))
    return lay_out_rows({"": [_contact(view.time, contact, largest_gap) for contact in contacts]}, columns), columns


def _contact(time: np.ndarray, contact: ContactTrace, largest_gap: float) -> Panel:
    style = {"linewidth": 1.2 if len(contact.normal) == 1 else 0.5}
    slips = contact.friction[2] if contact.friction else np.zeros_like(contact.active)

    def shade(axis: Axes) -> None:
        for active, slipping in zip(contact.active, slips, strict=True):
            for is_shaded, patch in ((active & ~slipping, _STICK_STYLE), (active & slipping, _SLIP_STYLE)):
                shade_spans(axis, time, is_shaded, **{**patch, "alpha": patch["alpha"] / len(slips)})

    def main(axis: Axes) -> None:
        shade(axis)
        if contact.friction:
            _friction(axis, time, contact.friction, style)
        draw_lines(axis, time, contact.normal, color=BLUE, **style)
        difference = 0.0 if contact.replay is None else np.abs(contact.replay - contact.normal).max(initial=0.0)
        if contact.replay is not None and difference > SAME * np.abs(contact.normal).max(initial=0.0):
            draw_lines(axis, time, contact.replay, color=INK, linestyle="--", linewidth=0.7)

    def below(axis: Axes) -> None:
        shade(axis)
        note_zero(axis)
        assert contact.gap is not None
        draw_lines(axis, time, contact.gap, color=GREEN, **style)
        if largest_gap > 0 and np.max(contact.gap) < NEGLIGIBLE * largest_gap:
            # On a separate scale, a gap that never opens would show only rounding errors.
            axis.set_ylim(-0.05 * largest_gap, largest_gap)

    return Panel(contact.title, main, None if contact.gap is None else below)


def _friction(axis: Axes, time: np.ndarray, data: tuple[np.ndarray, ...], style: dict[str, float]) -> None:
    friction, bound, _, degenerate = data
    for limit in bound:
        fill_band(axis, time, -limit, limit, **{**_CONE_STYLE, "alpha": _CONE_STYLE["alpha"] / len(bound)})
    note_zero(axis)
    draw_lines(axis, time, friction, color=VERMILLION, **style)
    step_middles = ((time[:-1] + time[1:]) / 2)[degenerate.any(axis=0)]
    axis.plot(step_middles, np.zeros_like(step_middles), **_DEGENERATE_STYLE)


_BESIDE = 1.81
"""Width of a figure next to the table of stages (46 mm) [inch]."""


def homotopy_figure(view: RunView) -> Figure:
    """Draw cost, complementarity and residual after each homotopy stage; zeros are not drawn."""
    numbers, stages = zip(*shown_stages(view.run.stages, view.run.meta["cost"])[0], strict=True)
    figure = Figure(figsize=(_BESIDE, min(max(1.9, 0.5 + 0.15 * len(numbers)), 2.8)))
    cost_axis, size_axis = figure.subplots(2, 1, sharex=True)
    number = np.array(numbers)
    accepted = np.array([stage.accepted for stage in stages])
    cost = np.array([stage.cost for stage in stages], dtype=float)
    cost_axis.plot(number[accepted], cost[accepted], "o-")
    cost_axis.plot(number[~accepted], cost[~accepted], "x", color=REPLAYED, label="stepped back")
    cost_axis.set_ylabel("cost")
    curves = [("complementarity", CYCLE[0], "largest λ gap"), ("residual", CYCLE[2], "residual")]
    labels = {stage.label for stage in stages}
    if len(labels) == 1:
        curves.append(("value", GREY, symbol(stage_title(labels.pop()))))
    for name, color, text in curves:
        values = np.array([getattr(stage, name) for stage in stages], dtype=float)
        is_positive = values > 0
        size_axis.semilogy(number[is_positive], values[is_positive], "o-", color=color, label=text)
    size_axis.set_ylabel("size")
    figure.legend(
        *size_axis.get_legend_handles_labels(),
        loc="outside lower center",
        ncols=2,
        fontsize=7,
        handlelength=1.2,
        columnspacing=0.8,
    )
    if not accepted.all():
        cost_axis.legend(fontsize=7)
    size_axis.set(xlabel="stage", xlim=(number[0] - 0.5, number[-1] + 0.5))
    size_axis.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    return figure


def candidates_figure(view: RunView) -> Figure:
    """Draw the exact cost of every solution that a solve compared, over the accumulated time in the solver."""
    attempts = view.run.meta["others"]
    times = np.cumsum([attempt.get("seconds") or 0.0 for attempt in attempts])
    costs = np.array([attempt["exact_cost"] for attempt in attempts], dtype=float)
    figure = Figure(figsize=(WIDTH, 1.6))
    axis = figure.subplots()
    axis.step(times, np.fmin.accumulate(costs), where="post", color=GREY)
    for time, cost, attempt in zip(times, costs, attempts, strict=True):
        axis.plot(time, cost, "o" if attempt["chosen"] else "x", color=BLUE if attempt["chosen"] else VERMILLION)
        axis.annotate(attempt.get("route", ""), (time, cost), xytext=(3, 3), textcoords="offset points", color=INK)
    axis.set(xlabel=label("time in the solver", "s"), ylabel="exact cost")
    axis.margins(x=0.25, y=0.15)
    use_log_if_wide(axis, costs)
    return figure


def gains_figure(view: RunView) -> Figure:
    """Draw feedback gains K over time as heat maps, one per input."""
    K = view.array("K")
    assert K is not None
    states, inputs = view.signals("states"), view.signals("inputs")
    figure = Figure(figsize=(WIDTH, 0.9 + (0.45 + 0.16 * len(states)) * len(inputs)))
    axes = figure.subplots(len(inputs), 1, sharex=True, squeeze=False)[:, 0]
    # The colours end at the 98th percentile, so that the other values are not pale because of an outlier.
    limit = float(np.quantile(np.abs(K), 0.98)) or 1.0
    image = None
    for index, axis in enumerate(axes):
        image = axis.pcolormesh(
            np.arange(K.shape[0] + 1) - 0.5,
            np.arange(len(states) + 1) - 0.5,
            K[:, index, :].T,
            cmap="PuOr",
            vmin=-limit,
            vmax=limit,
        )
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
