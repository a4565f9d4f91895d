"""Interleaved timing, so that other load on the computer affects all runners alike."""

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
    """Median seconds of one call: wall time, and processor time of all threads together.

    Only wall time grows with the load of other programs: ratios at equal numbers of threads are of
    processor time, rates and scaling with threads of wall time.
    """

    wall: float
    processor: float


@dataclass(frozen=True)
class Row:
    """One line of a table: what was measured, and the bounds that it must keep, if any."""

    what: str
    value: float
    unit: str
    least: float | None = None
    most: float | None = None

    @property
    def held(self) -> bool:
        """Whether the bounds are kept; NaN keeps none."""
        above = self.least is None or self.value >= self.least
        return above and (self.most is None or self.value <= self.most)


def race(runners: dict[str, Callable[[], object]], rounds: int = 7) -> dict[str, Seconds]:
    """Return median seconds of each runner over `rounds` alternating rounds, after one to warm up."""
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
    """Print the rows and whether each bound is kept, and fail if one is not.

    The caption shows the computer's average load over the last minute.
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
