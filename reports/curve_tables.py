"""The points and events of a continuation, on the terminal and on a page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.table import Table

from reports.console import knob_title, number, small, table_of


def curve_lines(name: str, rows: Sequence[Mapping[str, Any]], heads: bool) -> Iterator[str]:
    """Points of a continuation, a line each of at most 80 columns, with the heads if asked for."""
    if heads:
        yield _line(knob_title(name), "cost", "exact cost", "lam·gap", "iter")
    for row in rows:
        yield _line(
            f"{row['value']:.5g}", number(row["cost"], 7), number(row["exact_cost"], 7),
            small(row["complementarity"]), str(row["iterations"]), row["status"],
        )  # fmt: skip


def _line(*cells: str) -> str:
    widths = (12, 13, 13, 7, 5, 0)
    return "  ".join(f"{cell:>{wide}}" for cell, wide in zip(cells, widths, strict=False)).rstrip()


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
