"""Several runs side by side: what each costs beyond the cheapest, and where they part."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.console import number, small
from reports.figures.motion import Track, idle, tracks
from reports.figures.panels import Panel, Row, in_rows, lines, note_zero
from reports.notation import label
from reports.style import CYCLE, GREY, PLANNED, REPLAYED, WIDTH
from reports.view import RunView

_WIDE = 30.0
"""Times the second smallest difference beyond which differences are drawn by powers of ten."""


def rows(views: list[RunView]) -> list[list[str]]:
    """Table of the comparison: one row a property, one column a run; what all share is left out."""
    asked = [
        [key, *(str(view.run.record.get(key, "")) for view in views)]
        for key in ("problem", "contact", "method", "policy", "solver")
    ]
    found = [row for row in asked if len(set(row[1:])) > 1]
    runs = [view.run for view in views]
    found.append(["status", *(run.status.label for run in runs)])
    found.append(["referee", *(run.referee.word for run in runs)])
    found.append(["cost", *(number(run.meta["cost"], 7) for run in runs)])
    found.append(["exact cost", *(number(run.audit.exact_cost, 7) for run in runs)])
    found.append(["referee cost", *(number(run.referee.cost, 7) for run in runs)])
    for name, title in (
        ("complementarity", "largest λ gap"),
        ("dynamics_residual", "dynamics residual"),
        ("penetration", "penetration [m]"),
        ("state_gap", "plan to replay"),
    ):
        found.append([title, *(small(getattr(run.audit, name)) for run in runs)])
    found.append(["iterations", *(str(run.meta["iterations"]) for run in runs)])
    return found


def costs(views: list[RunView], names: list[str]) -> Figure:
    """What each run costs beyond the cheapest plan: planned, replayed, and under the referee."""
    kinds = [
        ("planned", "o", PLANNED, [view.run.meta["cost"] for view in views]),
        ("replayed, exact law", "s", REPLAYED, [view.run.audit.exact_cost for view in views]),
        ("under the referee", "^", CYCLE[6], [view.run.referee.cost for view in views]),
    ]
    values = np.array([[np.nan if c is None else c for c in found] for *_, found in kinds], float)
    least = float(np.nanmin(values[0]))
    off = values - least
    figure = Figure(figsize=(WIDTH, 0.65 + 0.2 * len(views)))
    axis = figure.subplots()
    place = np.arange(len(views))
    for (text, mark, color, _), found in zip(kinds, off, strict=True):
        axis.plot(found, place, mark, color=color, label=text, markersize=4.5, alpha=0.85)
    finite = np.where(np.isfinite(off), off, 0.0)
    axis.hlines(place, finite.min(axis=0), finite.max(axis=0), color=GREY, linewidth=0.8, zorder=0)
    positive = np.unique(off[np.isfinite(off) & (off > 1e-9 * max(abs(least), 1e-12))])
    if len(positive) > 1 and positive[-1] > _WIDE * positive[0]:
        axis.set_xscale("symlog", linthresh=float(positive[0]))
    axis.set_yticks(place, names)
    axis.set_ylim(len(views) - 0.5, -0.5)
    axis.set_xlabel(f"cost beyond the cheapest plan, {number(least, 7)}")
    axis.grid(visible=False, axis="y")
    figure.legend(loc="outside upper center", ncols=3)
    return figure


def same_instants(views: Sequence[RunView]) -> bool:
    """Whether the runs share their nodes in time, so that they have differences."""
    first = views[0].time
    return all(v.time.shape == first.shape and np.allclose(v.time, first) for v in views[1:])


def overlay_rows(views: list[RunView]) -> tuple[list[Row], list[str]]:
    """Every state, input and multiplier of all runs over time, and below what parts them from A.

    Multipliers that are zero throughout in every run are left out, and named.
    """
    whole = [{(t.heading, t.name): t for t in tracks(view)} for view in views]
    resting = set.intersection(*(set(idle(list(each.values()))) for each in whole))
    order = {key: track for each in whole for key, track in each.items()}
    differ = same_instants(views) and len({view.scenarios for view in views}) == 1
    kept = [key for key, track in order.items() if not (track.multiplier and key[1] in resting)]
    reach: dict[str, float] = {}
    for heading, name in kept:
        members = [each[heading, name] for each in whole if (heading, name) in each]
        most = max((_largest(m.plan - members[0].plan) for m in members if differ), default=0.0)
        reach[heading] = max(reach.get(heading, 0.0), most)
    panels: dict[str, list[Panel]] = {}
    for heading, name in kept:
        own = [
            (place, each[heading, name]) for place, each in enumerate(whole)
            if (heading, name) in each
        ]  # fmt: skip
        limit = reach[heading] if differ else None
        panels.setdefault(heading, []).append(_panel(own, views, limit))
    return in_rows(panels), sorted(resting)


def color_of(place: int) -> str:
    """Colour of a run in every picture of a comparison."""
    return CYCLE[place % len(CYCLE)]


def _panel(
    own: Sequence[tuple[int, Track]], views: Sequence[RunView], reach: float | None
) -> Panel:
    def main(axis: Axes) -> None:
        for place, track in own:
            lines(axis, views[place].time, track.plan, color=color_of(place),
                  linewidth=1.1 if len(track.plan) == 1 else 0.5)  # fmt: skip

    def below(axis: Axes) -> None:
        note_zero(axis)
        base = own[0][1].plan
        for place, track in own[1:]:
            lines(axis, views[place].time, track.plan - base, color=color_of(place), linewidth=0.9)
        limit = 1.1 * reach if reach else 1.0
        axis.set_ylim(-limit, limit)

    title = label(own[0][1].name, own[0][1].unit)
    return Panel(title, main, below if reach is not None else None)


def _largest(values: np.ndarray) -> float:
    return float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))
