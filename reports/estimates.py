"""Gradient estimates on the terminal and on a page."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table

from reports.console import live, number, table_of

if TYPE_CHECKING:
    from ocp.gradients.sweep import SweepProgress


@contextmanager
def progress(quiet: bool, check: Callable[[], None]) -> Iterator[Callable[[SweepProgress], None]]:
    """Yield a callback that prints rate and time left, and calls ``check``."""
    began, first = time.monotonic(), None
    with live(quiet, every_s=5.0, delay=True) as show:

        def report(state: SweepProgress) -> None:
            nonlocal first
            check()
            first = state.done if first is None else first
            show(progress_line(state, state.done - first, time.monotonic() - began))

        yield report


def progress_line(state: SweepProgress, since: int, seconds: float) -> str:
    """One line: points, samples, rate of this session, time left."""
    rate = since / seconds if seconds > 0 else 0.0
    left = f"{(state.total - state.done) / rate:.0f} s left" if rate > 0 else "time left unknown"
    points = f"point {state.points + 1} of {state.all_points}, " if state.all_points > 1 else ""
    return f"{points}{state.done / state.total:.0%}, {rate:.3g} samples/s, {left}"


def table(rows: Sequence[Mapping[str, Any]], swept: str | None) -> Table:
    """One line per estimate; for several components the norms."""
    several = any(isinstance(row["mean"], list) for row in rows)
    numbers = ("|mean|" if several else "mean", "std error", "variance", "reference")
    found = ((*columns, word) for *columns, _, word in (cells(row, bool(swept)) for row in rows))
    heads = ("estimator", *(f">{head}" for head in numbers), "verdict")
    return table_of(*([f">{swept}"] if swept else []), *heads, rows=found)


def _size(value: float | list[float] | None) -> float | None:
    if value is None or isinstance(value, float):
        return value
    return float(np.linalg.norm(value))


def cells(row: Mapping[str, Any], swept: bool) -> list[str]:
    """What was swept, estimator, mean, error, variance, reference, alpha, verdict, as text."""
    reference, short = row["reference"], row["verdict"].partition(" within")[0].partition(" at")[0]
    return [
        *([number(row["value"], 4)] if swept else []),
        row["estimator"],
        number(_size(row["mean"]), 5),
        number(_size(row["standard_error"]), 2),
        number(row["variance_trace"], 3),
        "–" if reference is None else number(_size(reference), 5),
        "" if row["alpha"] is None else number(row["alpha"], 3),
        "too wide" if row["wide"] else short,
    ]
