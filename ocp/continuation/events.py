"""Events of a continuation: changes of contact, bounds, folds, switches."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

LOCATION_TOLERANCE = 1e-6
"""Precision of an event's location, as a fraction of the parameter's range."""
EVENT_NAMES = {
    "contact": ("contact event", "contact events"),
    "degenerate": ("degenerate event", "degenerate events"),
    "bound": ("bound event", "bound events"),
    "fold": ("fold", "folds"),
    "switch": ("switch", "switches"),
}
"""Mapping from a kind of event to its name in singular and plural."""
PAIR_EVENTS = ("contact", "degenerate")
"""Kinds of events at which complementarity pairs change."""
MAX_LISTED_EVENTS = 3
"""Maximum number of events of a kind that a sentence lists."""


@dataclass(frozen=True)
class Event:
    """One event of a continuation at ``value``.

    ``kind`` is "contact" (strict complementarity is lost at one pair), "degenerate" (it is lost at
    several pairs at once; the pairs are not listed, since rounding errors determine their order), "bound" (it is lost
    at a bound or constraint), "fold" (the reduced KKT matrix is singular, the curve turns) or "switch"
    (another stationary point is cheaper, or the curve ends). ``contact`` and ``steps`` locate the event,
    ``change`` describes it.
    """

    kind: str
    value: float
    cost: float
    change: str
    contact: str = ""
    steps: tuple[int, ...] = ()

    def describe(self, parameter: str) -> str:
        """Return a clause that describes the event."""
        steps = "-".join(dict.fromkeys(f"{step}" for step in (*self.steps[:1], *self.steps[-1:])))
        subject = f"{self.contact!r} " if self.contact else ""
        location = f" at step{'s' if len(self.steps) > 1 else ''} {steps}" if steps else ""
        return f"{subject}{self.change}{location} ({parameter} = {self.value:.6g})"

    def row(self) -> dict[str, Any]:
        """Return the event as a JSON-serialisable dict."""
        return {**vars(self), "steps": list(self.steps)}


def degenerate_event(value: float, cost: float) -> Event:
    """Return an event of strict complementarity lost at several pairs at once."""
    return Event("degenerate", value, cost, "several pairs change at once")


def merge_simultaneous(events: list[Event], span: float | None) -> list[Event]:
    """Merge simultaneous events of pairs into a degenerate event, and events of one bound at several steps into one.

    Simultaneous means within 1e-6 of ``span``, or of the value if ``span`` is None (a log scale).
    """
    merged: list[Event] = []
    for event in events:
        at_once = [
            i
            for i, e in enumerate(merged)
            if abs(e.value - event.value) <= LOCATION_TOLERANCE * (span or abs(e.value))
            and ({e.kind, event.kind} <= set(PAIR_EVENTS) or _event_identity(e) == _event_identity(event))
        ]
        if not at_once:
            merged.append(event)
            continue
        first = merged[at_once[0]]
        if event.kind not in PAIR_EVENTS:
            steps = tuple(sorted({*first.steps, *event.steps}))
            merged[at_once[0]] = replace(first, steps=steps)
        elif (_event_identity(first), first.steps) != (_event_identity(event), event.steps):
            merged[at_once[0]] = degenerate_event(first.value, first.cost)
    return merged


def _event_identity(event: Event) -> tuple[str, str, str]:
    return event.kind, event.contact, event.change


def describe_events(events: list[Event], parameter: str) -> str:
    """Return a sentence on up to three events of each kind (bounds are only counted); "" without events."""
    sentences = []
    for kind, title in EVENT_NAMES.items():
        events_of_kind = [event for event in events if event.kind == kind]
        if not events_of_kind:
            continue
        count = f"{len(events_of_kind)} {title[len(events_of_kind) > 1]}"
        listed = ", ".join(event.describe(parameter) for event in events_of_kind[:MAX_LISTED_EVENTS])
        unlisted = len(events_of_kind) - MAX_LISTED_EVENTS
        unlisted_text = f" and {unlisted} more" if unlisted > 0 else ""
        sentences.append(count if kind == "bound" else f"{count}: {listed}{unlisted_text}")
    return "; ".join(sentences)
