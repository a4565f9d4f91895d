"""The points of a sweep as a table, on the terminal and on a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.table import Table

from reports.console import number, table_of

MOST = 200
"""Points that a table shows; all are in the stored study."""
HEADS = ("cost", "exact", "referee", "iter", "s", "verdict")


def point_rows(rows: Sequence[Mapping[str, Any]], dims: Sequence[str]) -> list[list[str]]:
    """Coordinates, costs, iterations, seconds and grade of each point, as text."""
    return [
        [
            *(f"{row[dim]:.4g}" for dim in dims),
            *(number(row[name], 6) for name in ("cost", "exact_cost", "referee_cost")),
            str(row["iterations"]), f"{row['seconds']:.1f}",
            str(row["status"] if row["grade"] == "failed" else row["grade"]),
        ]
        for row in rows[:MOST]
    ]  # fmt: skip


def point_table(rows: Sequence[Mapping[str, Any]], dims: Sequence[str]) -> Table:
    """The points of a sweep; what is left out is told below."""
    heads = [(dim.removeprefix("contact."), "right") for dim in dims]
    heads += [(head, "left" if head == "verdict" else "right") for head in HEADS]
    table = table_of(*heads, rows=point_rows(rows, dims))
    if len(rows) > MOST:
        table.caption, table.caption_justify = f"and {len(rows) - MOST} more points", "left"
    return table
