"""The points of a sweep: as a table, and one by one while it runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from rich.table import Table
from rich.text import Text

from ocp.sweeps.job import JobResult
from reports import console
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
    """The points of a sweep; a caption counts those left out."""
    heads = [f">{name}" for name in (*(dim.removeprefix("contact.") for dim in dims), *HEADS[:-1])]
    table = table_of(*heads, HEADS[-1], rows=point_rows(rows, dims))
    if len(rows) > MOST:
        table.caption, table.caption_justify = f"and {len(rows) - MOST} more points", "left"
    return table


Ended = Callable[[int, JobResult], None]
_BAR = 20


@contextmanager
def live(names: Sequence[str], before: int, quiet: bool) -> Iterator[Ended]:
    """Yield a callback for the place of each finished point; ``names`` label all points.

    The first ``before`` calls are points that were kept. On a terminal one line moves; elsewhere a
    line is printed every two seconds at most, and for each point that failed.
    """
    began, done = time.monotonic(), 0
    with console.live(quiet, every_s=2.0) as show:

        def ended(place: int, point: JobResult) -> None:
            nonlocal done
            done += 1
            if done <= before:
                return
            left = (time.monotonic() - began) / (done - before) * (len(names) - done)
            text = line(done, len(names), names[place], point.row, left)
            full = round(done / len(names) * _BAR)
            bar = Text(f"{'━' * full}{'╌' * (_BAR - full)} {text}")
            show(text, done == len(names) or not point.row["success"], lambda: bar)

        yield ended


def line(done: int, total: int, name: str, row: dict[str, Any], left: float) -> str:
    """Progress after a point, and its result, in one line."""
    found = f"cost {number(row['cost'], 5)}" if row["success"] else row["status"]
    return f"{done}/{total}  {name}  {found}  {duration(left)} left"


def duration(seconds: float) -> str:
    """A duration as text: ``40 s``, ``12 min``, ``3.5 h``."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
