"""What happens on the way of a continuation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

LOCATED = 1e-6
"""Within what share of the parameter's range an event is located."""
KINDS = {
    "contact": ("contact event", "contact events"),
    "bound": ("bound event", "bound events"),
    "fold": ("fold", "folds"),
    "switch": ("switch", "switches"),
}
"""What events are called, one and many."""
_LISTED = 3


@dataclass(frozen=True)
class Event:
    """What happens on the way at ``value``.

    ``kind`` is "contact" (strict complementarity is lost at a pair), "bound" (at another end),
    "fold" (the reduced KKT matrix is singular, the path turns) or "switch" (another stationary
    point is cheaper, or this one ends). ``contact`` and ``steps`` say where, ``change`` what.
    """

    kind: str
    value: float
    cost: float
    change: str
    contact: str = ""
    steps: tuple[int, ...] = ()

    def told(self, parameter: str) -> str:
        """The event in words."""
        steps = "-".join(dict.fromkeys(f"{step}" for step in (*self.steps[:1], *self.steps[-1:])))
        who = f"{self.contact!r} " if self.contact else ""
        where = f" at step{'s' if len(self.steps) > 1 else ''} {steps}" if steps else ""
        return f"{who}{self.change}{where} ({parameter} = {self.value:.6g})"

    def row(self) -> dict[str, Any]:
        """The event as JSON tells it."""
        return {**vars(self), "steps": list(self.steps)}


def joined(events: list[Event], span: float | None) -> list[Event]:
    """Events in order, those of one contact that happen at once as one.

    At once is within 1e-6 of ``span``, or of the value on a logarithmic scale, without span.
    """
    found: list[Event] = []
    for event in events:
        same = [
            i for i, e in enumerate(found)
            if (e.kind, e.contact, e.change) == (event.kind, event.contact, event.change)
            and abs(e.value - event.value) <= LOCATED * (span or abs(e.value))
        ]  # fmt: skip
        if same:
            steps = tuple(sorted({*found[same[0]].steps, *event.steps}))
            found[same[0]] = replace(found[same[0]], steps=steps)
        else:
            found.append(event)
    return found


def told(events: list[Event], parameter: str) -> str:
    """Events in a sentence, three of a kind; of bounds only how many. Empty without events."""
    parts = []
    for kind, words in KINDS.items():
        found = [event for event in events if event.kind == kind]
        if not found:
            continue
        count = f"{len(found)} {words[len(found) > 1]}"
        listed = ", ".join(event.told(parameter) for event in found[:_LISTED])
        more = f" and {len(found) - _LISTED} more" if len(found) > _LISTED else ""
        parts.append(count if kind == "bound" else f"{count}: {listed}{more}")
    return "; ".join(parts)
