"""The points and events of a continuation, on the terminal and on a page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.table import Table

from reports.console import knob_title, number, small, table_of


def curve_line(name: str, row: Mapping[str, Any]) -> str:
    """One point of a continuation in one line, at most 80 columns."""
    return (
        f"{knob_title(name)} {row['value']:.4g}  cost {number(row['cost'], 7)}"
        f"  exact {number(row['exact_cost'], 7)}  lam·gap {small(row['complementarity'])}"
        f"  {row['iterations']} it"
    )


def curve_table(name: str, rows: Sequence[Mapping[str, Any]]) -> Table:
    """The points of a continuation."""
    heads = (knob_title(name), "cost", "exact cost", "lam·gap", "iter")
    cells = (
        (f"{row['value']:.5g}", number(row["cost"], 7), number(row["exact_cost"], 7),
         small(row["complementarity"]), str(row["iterations"]), row["status"])
        for row in rows
    )  # fmt: skip
    return table_of(*((title, "right") for title in heads), ("", "left"), rows=cells)


def event_rows(events: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, ...]]:
    """Number, value, kind, what happens, where, and cost of events other than bounds being met."""
    kept = [event for event in events if event["kind"] != "bound"]
    for count, event in enumerate(kept, start=1):
        steps = ", ".join(str(step) for step in event["steps"])
        what = f"{event['contact']} {event['change']}".strip()
        yield (str(count), f"{event['value']:.8g}", event["kind"], what, steps,
               number(event["cost"], 7))  # fmt: skip


def event_table(name: str, events: Sequence[Mapping[str, Any]]) -> Table:
    """The events of a continuation."""
    return table_of(("", "right"), (knob_title(name), "right"), ("event", "left"), ("", "left"),
                    ("steps", "left"), ("cost", "right"), rows=event_rows(events))  # fmt: skip
