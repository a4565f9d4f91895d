"""A run over time: every state, input and multiplier, and how far its replay is from it."""

from __future__ import annotations

import fnmatch
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ocp.errors import InputError, did_you_mean
from reports.figures.panels import Panel, Row, between, draw_rows, in_rows, lines, note_zero
from reports.notation import label
from reports.style import PLANNED, REPLAYED
from reports.view import RunView

SAME = 1e-4
"""Share of a signal's range up to which plan and replay are one line."""
NEGLIGIBLE = 1e-6
"""Share of a size below which an amount is not drawn."""
_IDLE = 1e-9
"""Share of the largest multiplier in the same unit below which one counts as zero throughout."""
_BEYOND = 3.0
"""Times the plan's largest number up to which a replay is followed within the plan's panel."""
_STATES = {"m": "Positions", "rad": "Angles", "m/s": "Velocities", "rad/s": "Angular velocities", "s": "Times"}
_MULTIPLIERS = {"N s": "Impulses", "N": "Forces"}
_KINDS = {"normal": "Normal", "friction": "Friction", "slip": "Slip", "limit": "Limit"}


@dataclass(frozen=True)
class Track:
    """One component over time under the heading of its quantity.

    ``plan`` and ``again``, its replay under the exact law, are (S, N+1) at the nodes, or (S, N)
    held over the steps; ``again`` is None where there was no replay.
    """

    heading: str
    name: str
    unit: str
    plan: np.ndarray
    again: np.ndarray | None

    @property
    def multiplier(self) -> bool:
        """Whether it is a contact's, and no state or input."""
        return "λ" in self.heading

    @property
    def off(self) -> np.ndarray | None:
        """Replay minus plan."""
        return None if self.again is None else self.again - self.plan

    @property
    def parted(self) -> bool:
        """Whether the replay is another line than the plan."""
        return largest(self.off) > max(SAME * self.span, NEGLIGIBLE * self.size)

    @property
    def span(self) -> float:
        """Range of plan and replay together."""
        both = self.plan if self.again is None else np.append(self.plan, self.again)
        return float(np.ptp(both[np.isfinite(both)])) if np.isfinite(both).any() else 0.0

    @property
    def size(self) -> float:
        """Largest number that occurs."""
        both = [self.plan] if self.again is None else [self.plan, self.again]
        return max(largest(values) for values in both)


def tracks(view: RunView) -> list[Track]:
    """Every component of states, inputs and multipliers, in the order of their headings."""
    found: dict[str, list[Track]] = {}
    for kind, name in (("states", "x"), ("inputs", "u"), ("contacts", "lam")):
        values, again = view.array(name), view.array(f"{name}_replay")
        if values is None:
            continue
        if again is not None and again.shape[:2] != values.shape[:2]:
            again = None
        for index, signal in enumerate(view.signals(kind)):
            heading = _heading(view, kind, index)
            plan = mean_multiplier(view, values, index) if name == "lam" else values[..., index]
            other = None if again is None else again[..., index]
            track = Track(heading, signal.name, signal.unit, plan, other)
            found.setdefault(heading, []).append(track)
    return [track for group in found.values() for track in group]


def mean_multiplier(view: RunView, values: np.ndarray, index: int) -> np.ndarray:
    """One multiplier; of a law solved at several noise nodes the mean over them."""
    return values[..., index :: len(view.signals("contacts"))].mean(axis=-1)


def idle(found: list[Track]) -> list[str]:
    """Names of the multipliers that are zero throughout, beside the largest impulse or force."""
    multipliers = [track for track in found if track.multiplier]
    pushes = [track.size for track in multipliers if not track.heading.startswith("Slip")]
    most = max(pushes, default=0.0)
    return [track.name for track in multipliers if track.size <= _IDLE * most]


def apart(found: list[Track]) -> float:
    """Largest distance of plan and replay beside a state's or input's range; 0 without a replay."""
    shares = [
        largest(track.off) / track.span
        for track in found
        if track.off is not None and track.span > 0 and not track.multiplier
    ]
    return max(shares, default=0.0)


def undetermined(found: list[Track]) -> bool:
    """Whether multipliers of the replay are others although the motion is the same."""
    return not parted(found) and any(
        track.parted for track in found if track.multiplier and track.name not in idle(found)
    )


def parted(found: Sequence[Track]) -> bool:
    """Whether the replay of a state or an input is another line than its plan."""
    return any(track.parted for track in found if not track.multiplier)


def plan_rows(view: RunView, without: Collection[str] = (), signals: Collection[str] = ()) -> list[Row]:
    """Rows of panels, one a component, but for multipliers ``without`` and those that are zero.

    With names of ``signals`` only these. Where plan and replay part, the band between them is
    shaded and their difference drawn below, to one scale in each group; not for inputs that are the
    same by construction.
    """
    found, time = tracks(view), view.time
    resting = {*idle(found), *without}
    groups: dict[str, list[Track]] = {}
    for track in found:
        if track.name in signals if signals else not (track.multiplier and track.name in resting):
            groups.setdefault(track.heading, []).append(track)
    panels = {}
    for heading, members in groups.items():
        reach = max(largest(track.off) for track in members)
        panels[heading] = [_panel(one, time, reach if one.parted else None) for one in members]
    return in_rows(panels)


def chosen(view: RunView, words: str) -> list[str]:
    """Names of signals from words with commas, in which * stands for any letters.

    Raises :class:`~ocp.errors.InputError` for a word that fits none.
    """
    names = [track.name for track in tracks(view)]
    found: list[str] = []
    for word in (part.strip() for part in words.split(",")):
        fitting = fnmatch.filter(names, word)
        if not fitting:
            raise InputError(
                f"--signals: there is no signal {word!r}{did_you_mean(word, names)}; there are {', '.join(names)}"
            )
        found += fitting
    return found


def trajectories(view: RunView) -> Figure:
    """All of :func:`plan_rows` in one figure."""
    return draw_rows(plan_rows(view))


def _panel(track: Track, time: np.ndarray, reach: float | None) -> Panel:
    def below(axis: Axes) -> None:
        note_zero(axis)
        if track.off is not None and reach is not None:
            lines(axis, time, track.off, color=REPLAYED, linewidth=0.9 if _one(track) else 0.5)
            limit = 1.1 * reach if reach > 0 else 1.0
            axis.set_ylim(-limit, limit)

    def main(axis: Axes) -> None:
        _plan(axis, time, track, again=reach is not None)

    return Panel(label(track.name, track.unit), main, None if reach is None else below)


def _plan(axis: Axes, time: np.ndarray, track: Track, again: bool) -> None:
    width = 1.4 if _one(track) else 0.6
    lines(axis, time, track.plan, color=PLANNED, linewidth=width)
    if not _one(track):
        low, high = track.plan.min(axis=0), track.plan.max(axis=0)
        between(axis, time, low, high, color=PLANNED, alpha=0.15)
    if not again or track.again is None:
        return
    reach = _BEYOND * largest(track.plan)
    for plan, other in zip(track.plan, track.again, strict=True):
        between(axis, time, plan, other, color=REPLAYED, alpha=0.3 / len(track.plan) ** 0.5)
    lines(axis, time, track.again, color=REPLAYED, linewidth=0.5 * width)
    axis.autoscale_view()
    now = axis.get_ylim()
    if reach > 0:
        axis.set_ylim(max(now[0], -reach), min(now[1], reach))


def _one(track: Track) -> bool:
    return len(track.plan) == 1


def _heading(view: RunView, kind: str, index: int) -> str:
    """The quantity with its unit: of states what the unit says, of multipliers the pair's kind."""
    unit = view.signals(kind)[index].unit
    if kind == "states":
        return label(_STATES.get(unit, "States"), unit)
    if kind == "inputs":
        return label("Inputs", unit)
    pairs = view.problem.system.pairs if view.problem is not None else ()
    if len({pair.kind for pair in pairs}) < 2:
        return label(f"{_MULTIPLIERS.get(unit, 'Multipliers')} λ", unit)
    return label(f"{_KINDS[pairs[index].kind]} λ", unit)


def largest(values: np.ndarray | None) -> float:
    """The largest of the finite values, without sign; 0 where there is none."""
    if values is None:
        return 0.0
    return float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))
