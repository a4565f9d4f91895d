"""Table of the gradients of simulators."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.table import Table

from reports.tables.console import number, table_of

HEADS = ("world", "by", "slope", "exact slope", "ratio", "secants right from", "verdict")
"""Headings of the table of simulators; ``ratio`` is slope/exact slope."""


def gradients_table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return a table with one row for each simulator."""
    first, method, *numbers, verdict = HEADS
    return table_of(first, method, *(f">{head}" for head in numbers), verdict, rows=map(gradient_cells, rows))


def gradient_cells(row: Mapping[str, Any]) -> list[str]:
    """Return a simulator's cells: name, method, slope, exact slope, ratio, smallest right amplitude, and verdict."""
    if row["status"] != "done":
        return [row["world"], "", "", "", "", "", row["verdict"]]
    slope, truth = row["slope"], row["truth"]
    ratio = "–" if not truth or slope is None else number(slope / truth, 3)
    amplitudes = [finding["numbers"]["low"] for finding in row["findings"] if finding["code"] == "use-secant"]
    return [
        row["world"],
        row["method"],
        number(slope, 4),
        number(truth, 4),
        ratio,
        number(amplitudes[0], 2) if amplitudes else "",
        row["verdict"].replace("-", " "),
    ]
