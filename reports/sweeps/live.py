"""A sweep under way, on the terminal: points done, the last one, and the time that is left."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.text import Text

from ocp.sweeps.point import Point
from reports.console import number

Ended = Callable[[int, Point], None]
_EVERY_S = 2.0
_BAR = 20


@contextmanager
def live(names: Sequence[str], before: int, quiet: bool) -> Iterator[Ended]:
    """Yield what is called with the place of each finished point; ``names`` are all points'.

    The first ``before`` calls are points that were kept. On a terminal one line moves; elsewhere a
    line is printed every two seconds at most, and for each point that failed.
    """
    console = Console(stderr=True, highlight=False)
    began, last, done = time.monotonic(), -float("inf"), 0
    screen = Live(console=console, auto_refresh=False, transient=True)

    def ended(place: int, point: Point) -> None:
        nonlocal last, done
        done += 1
        if quiet or done <= before:
            return
        now = time.monotonic()
        left = (now - began) / (done - before) * (len(names) - done)
        said = line(done, len(names), names[place], point.row, left)
        if console.is_terminal:
            screen.update(Text(f"{_bar(done / len(names))} {said}"), refresh=True)
        elif now - last >= _EVERY_S or done == len(names) or not point.row["success"]:
            print(said, file=sys.stderr, flush=True)
            last = now

    if quiet or not console.is_terminal:
        yield ended
        return
    with screen:
        yield ended


def line(done: int, total: int, name: str, row: dict[str, Any], left: float) -> str:
    """Where a sweep stands after a point, and what that came to, in one line."""
    found = f"cost {number(row['cost'], 5)}" if row["success"] else row["status"]
    return f"{done}/{total}  {name}  {found}  {duration(left)} left"


def duration(seconds: float) -> str:
    """Seconds as people say them: ``40 s``, ``12 min``, ``3.5 h``."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def _bar(share: float) -> str:
    full = round(share * _BAR)
    return "━" * full + "╌" * (_BAR - full)
