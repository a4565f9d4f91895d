"""Interleaved timing, so that what else the machine does falls on every runner alike."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.table import Table


@dataclass(frozen=True)
class Seconds:
    """Median seconds of one call: on the wall's clock, and of all processors together.

    Beside other programs the first is longer and the second is not: ratios of equally many threads
    are of the second, rates and scaling with threads of the first.
    """

    wall: float
    processor: float


@dataclass(frozen=True)
class Row:
    """One line of a table: what was measured, and the bound that it must keep, if any."""

    what: str
    value: float
    unit: str
    least: float | None = None
    most: float | None = None

    @property
    def held(self) -> bool:
        """Whether the bound is kept; a value that is not a number keeps none."""
        above = self.least is None or self.value >= self.least
        return above and (self.most is None or self.value <= self.most)


def race(runners: dict[str, Callable[[], object]], rounds: int = 7) -> dict[str, Seconds]:
    """Median seconds of each runner over `rounds` rounds in turn, after one round to warm up."""
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in runners}
    for i in range(rounds + 1):
        for name, run in runners.items():
            begin = time.perf_counter(), time.process_time()
            run()
            end = time.perf_counter(), time.process_time()
            if i:
                times[name].append((end[0] - begin[0], end[1] - begin[1]))
    return {name: Seconds(*np.median(values, axis=0)) for name, values in times.items()}


def tell(title: str, rows: list[Row]) -> None:
    """Print the rows with whether each bound is held, and fail where one is not.

    The caption tells how many other processes wanted a processor over the last minute.
    """
    load = os.getloadavg()[0]
    table = Table(title=title, title_justify="left", caption=f"load {load:.1f}")
    for column in ("what", "measured", "bound", ""):
        table.add_column(column, justify="left" if column == "what" else "right")
    for row in rows:
        bounds = [("at least", row.least), ("at most", row.most)]
        bound = " ".join(f"{w} {v:g}{row.unit}" for w, v in bounds if v is not None)
        held = ("held" if row.held else "MISSED") if bound else ""
        table.add_row(row.what, f"{row.value:.3g}{row.unit}", bound, held)
    Console(width=100).print(table)
    missed = [f"{row.what}: {row.value:.3g}{row.unit}" for row in rows if not row.held]
    assert not missed, f"{title}: missed {'; '.join(missed)}"
