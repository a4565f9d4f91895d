"""Alternating timed runs, and tables of their results."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from statistics import median
from typing import Any

from rich.console import Console
from rich.table import Table


def alternate(runs: dict[str, Callable[[], Any]], rounds: int) -> tuple[dict[str, float], dict[str, Any]]:
    """Run all in turn, ``rounds`` times; return median seconds and last result of each.

    The clock is processor time: every runner is single-threaded, so that on an idle computer it
    equals wall time, and on a busy one it excludes the work of others.
    """
    seconds: dict[str, list[float]] = {key: [] for key in runs}
    results: dict[str, Any] = {}
    for _ in range(rounds):
        for key, run in runs.items():
            began = time.process_time()
            results[key] = run()
            seconds[key].append(time.process_time() - began)
    return {key: median(values) for key, values in seconds.items()}, results


def tell(title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table with its first column aligned left."""
    table = Table(title=title, title_justify="left")
    for i, column in enumerate(columns):
        table.add_column(column, justify="right" if i else "left", no_wrap=True)
    for row in rows:
        table.add_row(*(str(cell) for cell in row))
    console = Console(width=120)
    console.print()
    console.print(table)


def ms(seconds: float) -> str:
    """Return seconds as text in milliseconds."""
    return f"{1e3 * seconds:.0f}" if seconds >= 0.01 else f"{1e3 * seconds:.1f}"
