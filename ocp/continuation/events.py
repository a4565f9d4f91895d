"""Events of a continuation: changes of contact, bounds, folds, switches."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

LOCATED = 1e-6
"""Within what share of the parameter's range an event is located."""
KINDS = {
    "contact": ("contact event", "contact events"),
    "degenerate": ("degenerate event", "degenerate events"),
    "bound": ("bound event", "bound events"),
    "fold": ("fold", "folds"),
    "switch": ("switch", "switches"),
}
"""Names of events, singular and plural."""
PAIRS = ("contact", "degenerate")
"""Kinds of events at which pairs change."""
_LISTED = 3


@dataclass(frozen=True)
class Event:
    """One event of a continuation at ``value``.

    ``kind`` is "contact" (strict complementarity is lost at one pair), "degenerate" (at several at
    once, which are not listed: their order is within rounding), "bound" (at another end),
    "fold" (the reduced KKT matrix is singular, the path turns) or "switch" (another stationary
    point is cheaper, or this one ends). ``contact`` and ``steps`` say where,
    ``change`` what.
    """

    kind: str
    value: float
    cost: float
    change: str
    contact: str = ""
    steps: tuple[int, ...] = ()

    def describe(self, parameter: str) -> str:
        """Describe the event in half a sentence."""
        steps = "-".join(dict.fromkeys(f"{step}" for step in (*self.steps[:1], *self.steps[-1:])))
        who = f"{self.contact!r} " if self.contact else ""
        where = f" at step{'s' if len(self.steps) > 1 else ''} {steps}" if steps else ""
        return f"{who}{self.change}{where} ({parameter} = {self.value:.6g})"

    def row(self) -> dict[str, Any]:
        """The event as JSON."""
        return {**vars(self), "steps": list(self.steps)}


def degenerate(value: float, cost: float) -> Event:
    """The event at which strict complementarity is lost at several pairs at once."""
    return Event("degenerate", value, cost, "several pairs change at once")


def joined(events: list[Event], span: float | None) -> list[Event]:
    """Events in order; of those that happen at once, pairs as one degenerate event.

    Steps of one bound are joined too.
    At once is within 1e-6 of ``span``, or of the value on a logarithmic scale, without span.
    """
    found: list[Event] = []
    for event in events:
        at_once = [
            i
            for i, e in enumerate(found)
            if abs(e.value - event.value) <= LOCATED * (span or abs(e.value))
            and ({e.kind, event.kind} <= set(PAIRS) or _named(e) == _named(event))
        ]
        if not at_once:
            found.append(event)
            continue
        first = found[at_once[0]]
        if event.kind not in PAIRS:
            steps = tuple(sorted({*first.steps, *event.steps}))
            found[at_once[0]] = replace(first, steps=steps)
        elif (_named(first), first.steps) != (_named(event), event.steps):
            found[at_once[0]] = degenerate(first.value, first.cost)
    return found


def _named(event: Event) -> tuple[str, str, str]:
    return event.kind, event.contact, event.change


def describe_events(events: list[Event], parameter: str) -> str:
    """Events in a sentence, three of a kind; of bounds only how many. Empty without events."""
    parts = []
    for kind, words in KINDS.items():
        found = [event for event in events if event.kind == kind]
        if not found:
            continue
        count = f"{len(found)} {words[len(found) > 1]}"
        listed = ", ".join(event.describe(parameter) for event in found[:_LISTED])
        more = f" and {len(found) - _LISTED} more" if len(found) > _LISTED else ""
        parts.append(count if kind == "bound" else f"{count}: {listed}{more}")
    return "; ".join(parts)
