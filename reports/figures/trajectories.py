"""Trajectories of a run: every state, input and multiplier, with the difference from its replay."""

from __future__ import annotations

import fnmatch
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ocp.errors import InputError, did_you_mean
from reports.drawing.notation import label
from reports.drawing.strobe import largest_size
from reports.drawing.style import PLANNED, REPLAYED
from reports.drawing.view import RunView
from reports.figures.panels import Panel, Row, draw_lines, draw_rows, fill_band, lay_out_rows, note_zero

SAME = 1e-4
"""Difference up to which plan and replay count as equal, as a fraction of a signal's range."""
NEGLIGIBLE = 1e-6
"""Value that is negligible in a figure, as a fraction of the largest value."""
_IDLE = 1e-9
"""Multiplier that counts as always zero, as a fraction of the largest multiplier other than slips."""
_BEYOND = 3.0
"""Largest value of a replay in a panel, as a multiple of the plan's largest magnitude."""
_STATE_HEADINGS = {"m": "Positions", "rad": "Angles", "m/s": "Velocities", "rad/s": "Angular velocities", "s": "Times"}
"""Mapping from units of states to headings."""
_MULTIPLIER_HEADINGS = {"N s": "Impulses", "N": "Forces"}
"""Mapping from units of multipliers to headings."""
_PAIR_HEADINGS = {"normal": "Normal", "friction": "Friction", "slip": "Slip", "limit": "Limit"}
"""Mapping from kinds of pairs to headings of their multipliers."""


@dataclass(frozen=True)
class Track:
    """One component of states, inputs or multipliers over time, under the heading of its quantity.

    ``plan`` and ``replay`` are its values in the plan and in the replay under the exact law, (S, N+1) at the
    nodes or (S, N) held over the steps; ``replay`` is None if there was no replay.
    """

    heading: str
    name: str
    unit: str
    plan: np.ndarray
    replay: np.ndarray | None

    @property
    def is_multiplier(self) -> bool:
        """Whether the component is a contact multiplier, not a state or input."""
        return "λ" in self.heading

    @property
    def difference(self) -> np.ndarray | None:
        """Replay minus plan, None without a replay."""
        return None if self.replay is None else self.replay - self.plan

    @property
    def differs(self) -> bool:
        """Whether the replay differs visibly from the plan."""
        return largest_size(self.difference) > max(SAME * self.span, NEGLIGIBLE * self.size)

    @property
    def span(self) -> float:
        """Range of plan and replay together."""
        values = self.plan if self.replay is None else np.append(self.plan, self.replay)
        return float(np.ptp(values[np.isfinite(values)])) if np.isfinite(values).any() else 0.0

    @property
    def size(self) -> float:
        """Largest magnitude in plan and replay."""
        arrays = [self.plan] if self.replay is None else [self.plan, self.replay]
        return max(largest_size(values) for values in arrays)


def tracks(view: RunView) -> list[Track]:
    """Return every component of states, inputs and multipliers, in the order of their headings."""
    groups: dict[str, list[Track]] = {}
    for kind, name in (("states", "x"), ("inputs", "u"), ("contacts", "lam")):
        values, replayed = view.array(name), view.array(f"{name}_replay")
        if values is None:
            continue
        if replayed is not None and replayed.shape[:2] != values.shape[:2]:
            replayed = None
        for index, signal in enumerate(view.signals(kind)):
            heading = _heading(view, kind, index)
            plan = mean_multiplier(view, values, index) if name == "lam" else values[..., index]
            replay = None if replayed is None else replayed[..., index]
            track = Track(heading, signal.name, signal.unit, plan, replay)
            groups.setdefault(heading, []).append(track)
    return [track for group in groups.values() for track in group]


def mean_multiplier(view: RunView, values: np.ndarray, index: int) -> np.ndarray:
    """Return one multiplier, averaged over the noise nodes of the law if it has several."""
    return values[..., index :: len(view.signals("contacts"))].mean(axis=-1)


def idle_multipliers(all_tracks: list[Track]) -> list[str]:
    """Return the names of multipliers that are always zero, relative to the largest impulse or force."""
    multipliers = [track for track in all_tracks if track.is_multiplier]
    pushes = [track.size for track in multipliers if not track.heading.startswith("Slip")]
    largest_push = max(pushes, default=0.0)
    return [track.name for track in multipliers if track.size <= _IDLE * largest_push]


def replay_deviation(all_tracks: list[Track]) -> float:
    """Return the largest deviation of the replay, relative to the range of a state or input; 0 without a replay."""
    shares = [
        largest_size(track.difference) / track.span
        for track in all_tracks
        if track.difference is not None and track.span > 0 and not track.is_multiplier
    ]
    return max(shares, default=0.0)


def multipliers_undetermined(all_tracks: list[Track]) -> bool:
    """Return whether multipliers of the replay differ from the plan although the motion is the same."""
    return not replay_differs(all_tracks) and any(
        track.differs for track in all_tracks if track.is_multiplier and track.name not in idle_multipliers(all_tracks)
    )


def replay_differs(all_tracks: Sequence[Track]) -> bool:
    """Return whether the replay of any state or input differs visibly from the plan."""
    return any(track.differs for track in all_tracks if not track.is_multiplier)


def plan_rows(view: RunView, omitted: Collection[str] = (), signals: Collection[str] = ()) -> list[Row]:
    """Return rows of panels, one panel per component, except multipliers that are ``omitted`` or always zero.

    If ``signals`` is not empty, only these components have panels. If plan and replay differ, the band between
    them is shaded and their difference is drawn below, on the same scale within a group.
    """
    all_tracks, time = tracks(view), view.time
    idle_names = {*idle_multipliers(all_tracks), *omitted}
    groups: dict[str, list[Track]] = {}
    for track in all_tracks:
        if track.name in signals if signals else not (track.is_multiplier and track.name in idle_names):
            groups.setdefault(track.heading, []).append(track)
    panels = {}
    for heading, members in groups.items():
        largest_difference = max(largest_size(track.difference) for track in members)
        panels[heading] = [_panel(track, time, largest_difference if track.differs else None) for track in members]
    return lay_out_rows(panels)


def select_signals(view: RunView, patterns: str) -> list[str]:
    """Return the names of signals that match words separated by commas; * is a wildcard.

    Raises :class:`~ocp.errors.InputError` for a word that matches no signal.
    """
    names = [track.name for track in tracks(view)]
    matched: list[str] = []
    for pattern in (pattern.strip() for pattern in patterns.split(",")):
        fitting = fnmatch.filter(names, pattern)
        if not fitting:
            raise InputError(
                f"--signals: there is no signal {pattern!r}{did_you_mean(pattern, names)}; there are {', '.join(names)}"
            )
        matched += fitting
    return matched


def trajectory_figure(view: RunView) -> Figure:
    """Draw all panels of :func:`plan_rows` in one figure."""
    return draw_rows(plan_rows(view))


def _panel(track: Track, time: np.ndarray, largest_difference: float | None) -> Panel:
    def below(axis: Axes) -> None:
        note_zero(axis)
        if track.difference is not None and largest_difference is not None:
            draw_lines(axis, time, track.difference, color=REPLAYED, linewidth=0.9 if _is_single(track) else 0.5)
            limit = 1.1 * largest_difference if largest_difference > 0 else 1.0
            axis.set_ylim(-limit, limit)

    def main(axis: Axes) -> None:
        _plan(axis, time, track, with_replay=largest_difference is not None)

    return Panel(label(track.name, track.unit), main, None if largest_difference is None else below)


def _plan(axis: Axes, time: np.ndarray, track: Track, with_replay: bool) -> None:
    width = 1.4 if _is_single(track) else 0.6
    draw_lines(axis, time, track.plan, color=PLANNED, linewidth=width)
    if not _is_single(track):
        low, high = track.plan.min(axis=0), track.plan.max(axis=0)
        fill_band(axis, time, low, high, color=PLANNED, alpha=0.15)
    if not with_replay or track.replay is None:
        return
    reach = _BEYOND * largest_size(track.plan)
    for plan, replayed in zip(track.plan, track.replay, strict=True):
        fill_band(axis, time, plan, replayed, color=REPLAYED, alpha=0.3 / len(track.plan) ** 0.5)
    draw_lines(axis, time, track.replay, color=REPLAYED, linewidth=0.5 * width)
    axis.autoscale_view()
    limits = axis.get_ylim()
    if reach > 0:
        axis.set_ylim(max(limits[0], -reach), min(limits[1], reach))


def _is_single(track: Track) -> bool:
    return len(track.plan) == 1


def _heading(view: RunView, kind: str, index: int) -> str:
    """Return the heading of a signal with its unit: states by unit, multipliers by the kind of their pair."""
    unit = view.signals(kind)[index].unit
    if kind == "states":
        return label(_STATE_HEADINGS.get(unit, "States"), unit)
    if kind == "inputs":
        return label("Inputs", unit)
    pairs = view.problem.system.pairs if view.problem is not None else ()
    if len({pair.kind for pair in pairs}) < 2:
        return label(f"{_MULTIPLIER_HEADINGS.get(unit, 'Multipliers')} λ", unit)
    return label(f"{_PAIR_HEADINGS[pairs[index].kind]} λ", unit)
