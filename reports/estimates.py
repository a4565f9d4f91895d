"""Gradient estimates on the terminal and on a page."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table

from reports.console import number

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ocp.gradients.sweep import Progress
    from ocp.store.stored_run import StoredRun

_EVERY_S = {True: 0.1, False: 5.0}


@contextmanager
def progress(quiet: bool, check: Callable[[], None]) -> Iterator[Callable[[Progress], None]]:
    """Yield what a study calls as it samples: rate and time left; ``check`` is called each time."""
    terminal = sys.stderr.isatty()
    began = last = time.monotonic()
    first: int | None = None

    def report(seen: Progress) -> None:
        nonlocal last, first
        check()
        first = seen.done if first is None else first
        now = time.monotonic()
        if quiet or now - last < _EVERY_S[terminal]:
            return
        last = now
        line = progress_line(seen, seen.done - first, now - began)
        print(f"\r\033[K{line}" if terminal else line, end="" if terminal else "\n",
              file=sys.stderr, flush=True)  # fmt: skip

    try:
        yield report
    finally:
        if terminal and not quiet:
            print("\r\033[K", end="", file=sys.stderr, flush=True)


def progress_line(seen: Progress, since: int, seconds: float) -> str:
    """One line: points, samples, rate of this session, time left."""
    rate = since / seconds if seconds > 0 else 0.0
    left = f"{(seen.total - seen.done) / rate:.0f} s left" if rate > 0 else "time left unknown"
    points = f"point {seen.points + 1} of {seen.all_points}, " if seen.all_points > 1 else ""
    return f"{points}{seen.done / seen.total:.0%}, {rate:.3g} samples/s, {left}"


def table(rows: Sequence[Mapping[str, Any]], swept: str | None) -> Table:
    """One line an estimate; of a decision with several components the norm is told."""
    shown = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    several = any(isinstance(row["mean"], list) for row in rows)
    heads = [swept] if swept else []
    heads += ["estimator", "|mean|" if several else "mean", "std error", "variance", "reference"]
    for head in heads:
        shown.add_column(head, justify="left" if head == "estimator" else "right")
    shown.add_column("verdict")
    for row in rows:
        cells = [number(row["value"], 4)] if swept else []
        known = row["reference"]
        cells += [
            row["estimator"],
            number(_size(row["mean"]), 5),
            number(_size(row["standard_error"]), 2),
            number(row["variance_trace"], 3),
            "–" if known is None else number(_size(known), 5),
        ]
        shown.add_row(*cells, _word(row))
    return shown


def _word(row: Mapping[str, Any]) -> str:
    """The verdict, short enough for a table; a wide interval cannot tell."""
    short = row["verdict"].partition(" within")[0].partition(" at")[0]
    return f"{short}, wide" if row["wide"] else short


def _size(value: float | list[float] | None) -> float | None:
    if value is None or isinstance(value, float):
        return value
    return float(np.linalg.norm(value))


def estimate_page(run: StoredRun) -> tuple[dict[str, Any], dict[str, Figure]]:
    """Content and figure of a stored estimate."""
    from ocp.errors import InputError
    from problems import describe
    from problems.objectives import named
    from reports.bibliography import full_citation
    from reports.figures import estimate as drawing

    meta = run.meta
    try:
        spec = named(run.record.get("source") or meta["problem"])
    except InputError:
        spec = None
    params = run.record["params"]
    cited = spec.citation if spec else None
    swept = meta["sweep"]
    content = {
        "title": f"Gradient of {meta['problem']}",
        "hash": meta["hash"],
        "verdict": meta["verdict"],
        "caption": drawing.caption(run),
        "swept": swept["name"] if swept else "",
        "rows": [_cells(row, bool(swept)) for row in meta["estimates"]],
        "explanations": [
            f"{row['estimator']}: {row['explanation']}" for row in meta["estimates"]
        ] if not swept else [],
        "equations": list(spec.equations) if spec else [],
        "parameters": [
            [about["name"], number(params.get(about["name"])),
             "" if about["unit"] == "1" else about["unit"], about["description"]]
            for about in (describe(spec) if spec else [])
        ],
        "citation": f"{cited.text}. {full_citation(cited.key)}." if cited else "",
        "settings": [
            [key.replace("_", " "), number(value) if isinstance(value, float) else str(value)]
            for key, value in run.record.items()
            if value not in (None, [], {}) and key not in ("params", "problem", "sweep", "source")
        ],
        "versions": [[name, version] for name, version in meta.get("versions", {}).items()],
    }  # fmt: skip
    return content, {"estimate": drawing.draw(run)}


def _cells(row: Mapping[str, Any], swept: bool) -> list[str]:
    known = row["reference"]
    return [
        *([number(row["value"], 4)] if swept else []),
        row["estimator"],
        number(_size(row["mean"]), 5),
        number(_size(row["standard_error"]), 2),
        number(row["variance_trace"], 3),
        "–" if known is None else number(_size(known), 5),
        "" if row["alpha"] is None else number(row["alpha"], 3),
        _word(row),
    ]
