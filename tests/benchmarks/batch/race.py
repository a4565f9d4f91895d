"""Interleaved timing, so that what else the machine does falls on every runner alike."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from rich.console import Console
from rich.table import Table


def race(runners: dict[str, Callable[[], object]], rounds: int = 7) -> dict[str, float]:
    """Median seconds of each runner over `rounds` rounds in turn, after one round to warm up."""
    times: dict[str, list[float]] = {name: [] for name in runners}
    for i in range(rounds + 1):
        for name, run in runners.items():
            begin = time.perf_counter()
            run()
            if i:
                times[name].append(time.perf_counter() - begin)
    return {name: float(np.median(values)) for name, values in times.items()}


def tell(title: str, rows: list[tuple[str, float, str, float | None]]) -> None:
    """Print rows (what, measured, unit, floor or None) with whether each floor is met."""
    table = Table(title=title, title_justify="left")
    for column in ("what", "measured", "floor", "met"):
        table.add_column(column, justify="left" if column == "what" else "right")
    for what, value, unit, floor in rows:
        met = "" if floor is None else ("yes" if value >= floor else "NO")
        bound = "" if floor is None else f"{floor:g}{unit}"
        table.add_row(what, f"{value:.3g}{unit}", bound, met)
    Console(width=100).print(table)
