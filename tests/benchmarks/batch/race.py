"""Interleaved timing, so that what else the machine does falls on every runner alike."""

from __future__ import annotations

import os
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
    """Print rows (what, measured, unit, floor or None) with whether each floor is held.

    The caption tells how many other processes wanted a processor over the last minute.
    """
    load = os.getloadavg()[0]
    table = Table(title=title, title_justify="left", caption=f"load {load:.1f}")
    for column in ("what", "measured", "floor", ""):
        table.add_column(column, justify="left" if column == "what" else "right")
    for what, value, unit, floor in rows:
        held = "" if floor is None else ("held" if value >= floor else "MISSED")
        bound = "" if floor is None else f"{floor:g}{unit}"
        table.add_row(what, f"{value:.3g}{unit}", bound, held)
    Console(width=100).print(table)
