"""Tables of specs, stored runs, sweeps and estimates, and the progress of sweeps and estimates."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table
from rich.text import Text

from reports.tables.console import live, number, small, stage_title, table_of, value_text

if TYPE_CHECKING:
    from ocp.gradients.sweep import SweepProgress
    from ocp.jobs.sweep_job import JobResult
    from ocp.store.stored_run import StoredRun
    from problems.spec import Golden
    from problems.studies import Claim


def parameter_table(parameters: Sequence[Mapping[str, Any]]) -> Table:
    """Return a table of a problem's parameters with default, unit and meaning."""
    table = table_of("parameter", ">default", "unit", "")
    for row in parameters:
        value, meaning = row["value"], row["description"]
        if isinstance(value, str):
            table.add_row(row["name"], value, "", f"{meaning} ({row['range']})")
            continue
        default = number(value) if isinstance(value, int | float) else "required"
        table.add_row(row["name"], default, row["unit"], meaning)
    return table


def golden_table(golden: Mapping[str, Golden]) -> Table:
    """Return a table of best known costs, their certificates, and the number of solves tried for each."""
    rows = (
        (name, best.method, number(best.cost, 9), best.certificate, str(best.tried)) for name, best in golden.items()
    )
    return table_of("best known", "method", ">cost", "certificate", ">of solves", rows=rows)


def run_table(run: StoredRun) -> Table:
    """Return a table of a run's metadata, one row per key."""
    table = table_of("", "", header=False)
    meta, record = run.meta, run.meta.get("record") or {}
    table.add_row("run", str(run.path))
    for key in ("kind", "problem", "created", "status", "cost", "return", "iterations", "seed", "tags", "revision"):
        if meta.get(key) not in (None, []):
            table.add_row(key, _inline(meta[key]))
    for key, value in record.items():
        if value not in (None, {}, []) and key not in ("problem", "seed"):
            table.add_row(key, _inline(value))
    table.add_row("command", " ".join(meta.get("argv") or []))
    table.add_row("versions", _inline(meta.get("versions") or {}))
    table.add_row("arrays", ", ".join(str(name) for name in run.data.data_vars))
    return table


def claim_table(claims: Sequence[Claim]) -> Table:
    """Return a table of a study's claims: source, expected value, measured value, verdict."""
    from problems.studies.study import claim_verdict

    table = Table(box=None, pad_edge=False, padding=(0, 1, 1, 0))
    for name, share in (("claim", 6), ("source", 4), ("expected", 4), ("measured", 5)):
        table.add_column(name, ratio=share, overflow="fold")
    table.add_column("holds", no_wrap=True)
    marks = {"holds": "yes", "does not hold": "NO"}
    for claim in claims:
        verdict = claim_verdict(claim.holds, claim.margin)
        cells = (claim.claim, claim.source, claim.expected, claim.measured)
        table.add_row(*map(Text, cells), marks.get(verdict, verdict))
    return table


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key}={_inline(item)}" for key, item in value.items())
    if isinstance(value, list):
        return " ".join(map(_inline, value))
    return value_text(value)


def curve_lines(name: str, rows: Sequence[Mapping[str, Any]], heads: bool) -> Iterator[str]:
    """Yield one line of at most 80 columns per point of a continuation, with a heading before them if ``heads``."""
    if heads:
        yield _cells(stage_title(name), "cost", "exact cost", "lam·gap", "iter")
    for row in rows:
        yield _cells(
            f"{row['value']:.5g}",
            number(row["cost"], 7),
            number(row["exact_cost"], 7),
            small(row["complementarity"]),
            str(row["iterations"]),
            row["status"],
        )


def _cells(*cells: str) -> str:
    widths = (12, 13, 13, 7, 5, 0)
    return "  ".join(f"{cell:>{column_width}}" for cell, column_width in zip(cells, widths, strict=False)).rstrip()


def event_rows(events: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, ...]]:
    """Yield a row per event except active bounds: number, value, kind, change, steps and cost."""
    listed = [event for event in events if event["kind"] != "bound"]
    for count, event in enumerate(listed, start=1):
        steps = ", ".join(str(step) for step in event["steps"])
        change = f"{event['contact']} {event['change']}".strip()
        yield (str(count), f"{event['value']:.8g}", event["kind"], change, steps, number(event["cost"], 7))


def event_table(name: str, events: Sequence[Mapping[str, Any]]) -> Table:
    """Return a table of the events of a continuation in parameter ``name``."""
    heads = (">", f">{stage_title(name)}", "event", "", "steps", ">cost")
    return table_of(*heads, rows=event_rows(events))


Row = Mapping[str, Any]


def run_lines(rows: Sequence[Row]) -> Iterator[str]:
    """Yield two lines per run: number, name, problem and outcome; then law, method, N and scenarios."""
    column_width = max(len(row["at"]) for row in rows)
    for row in rows:
        name = row["run"].rpartition("/")[2]
        yield f"{row['at']:>{column_width}}  {name}  {row['problem']}  {run_outcome(row)}"
        detail = row["damage"] or ", ".join(_parts(row))
        margin = " " * (column_width + 2)
        yield from wrap(detail, 80, initial_indent=margin, subsequent_indent=margin, break_on_hyphens=False)


def run_outcome(row: Row) -> str:
    """Return the result of a run as text: the return of a training, or grade (or status) and cost of other runs."""
    if row["damage"]:
        return "damaged"
    if row["return"] is not None:
        return f"return {number(row['return'], 4)}"
    verdict = row["grade"] if row["grade"] not in (None, "failed") else row["status"]
    cost = "" if row["cost"] is None else f"  cost {number(row['cost'])}"
    return f"{verdict}{cost}"


def _parts(row: Row) -> Iterator[str]:
    if row["kind"] != "solve":
        over = f" over {row['over']}" if row["over"] else ""
        yield f"{row['kind']}{over}"
    if row["algorithm"]:
        yield f"{row['algorithm']}, seed {row['seed']}"
    if row["contact"]:
        law_settings = (row["contact_settings"] or {}).items()
        values = (f"{name}={value_text(value)}" for name, value in law_settings if value is not None)
        yield " ".join([row["contact"], *values])
    for key in ("method", "policy"):
        if row[key]:
            yield row[key]
    if row["N"] is not None:
        yield f"N={row['N']}"
        yield f"{row['scenarios']} scenario{'' if row['scenarios'] == 1 else 's'}"
    if row["tags"]:
        yield "tagged " + " ".join(row["tags"])


MAX_ROWS = 200
"""Maximum number of points that a table shows."""
POINT_HEADS = ("cost", "exact", "referee", "iter", "s", "verdict")
"""Headings of a sweep's table of points, after the headings of the swept quantities."""


def point_rows(rows: Sequence[Mapping[str, Any]], dims: Sequence[str]) -> list[list[str]]:
    """Return a row per point of a sweep: coordinates, costs, iterations, seconds and grade, as text."""
    return [
        [
            *(f"{row[dim]:.4g}" for dim in dims),
            *(number(row[name], 6) for name in ("cost", "exact_cost", "referee_cost")),
            str(row["iterations"]),
            f"{row['seconds']:.1f}",
            str(row["status"] if row["grade"] == "failed" else row["grade"]) + ", outlier" * bool(row.get("outlier")),
        ]
        for row in rows[:MAX_ROWS]
    ]


def point_table(rows: Sequence[Mapping[str, Any]], dims: Sequence[str]) -> Table:
    """Return a table of the points of a sweep, with a caption that counts the points left out."""
    heads = [f">{name}" for name in (*(dim.removeprefix("contact.") for dim in dims), *POINT_HEADS[:-1])]
    table = table_of(*heads, POINT_HEADS[-1], rows=point_rows(rows, dims))
    if len(rows) > MAX_ROWS:
        table.caption, table.caption_justify = f"and {len(rows) - MAX_ROWS} more points", "left"
    return table


_BAR_WIDTH = 20
"""Width of a progress bar [characters]."""


@contextmanager
def sweep_progress(names: Sequence[str], n_resumed: int, quiet: bool) -> Iterator[Callable[[int, JobResult], None]]:
    """Yield a callback of the index of a finished point and its result; ``names`` are the labels of all points.

    The first ``n_resumed`` calls, for points finished earlier, show nothing. On a terminal there is one live
    line; otherwise a line is printed at most every two seconds, and for each point that failed.
    """
    start_s, n_done = time.monotonic(), 0
    with live(quiet, every_s=2.0) as show:

        def on_point(index: int, point: JobResult) -> None:
            nonlocal n_done
            n_done += 1
            if n_done <= n_resumed:
                return
            seconds_left = (time.monotonic() - start_s) / (n_done - n_resumed) * (len(names) - n_done)
            text = sweep_line(n_done, len(names), names[index], point.row, seconds_left)
            n_filled = round(n_done / len(names) * _BAR_WIDTH)
            bar = Text(f"{'━' * n_filled}{'╌' * (_BAR_WIDTH - n_filled)} {text}")
            show(text, n_done == len(names) or not point.row["success"], lambda: bar)

        yield on_point


def sweep_line(done: int, total: int, name: str, row: dict[str, Any], seconds_left: float) -> str:
    """Return one line: number of finished points, result of the last point, remaining time."""
    finding = f"cost {number(row['cost'], 5)}" if row["success"] else row["status"]
    return f"{done}/{total}  {name}  {finding}  {format_duration(seconds_left)} left"


def format_duration(seconds: float) -> str:
    """Return a duration as text, such as ``40 s``, ``12 min`` or ``3.5 h``."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


@contextmanager
def estimate_progress(quiet: bool, check: Callable[[], None]) -> Iterator[Callable[[SweepProgress], None]]:
    """Yield a callback that calls ``check`` and shows the rate and the remaining time of an estimate."""
    start_s, n_first = time.monotonic(), None
    with live(quiet, every_s=5.0, delay=True) as show:

        def report(state: SweepProgress) -> None:
            nonlocal n_first
            check()
            n_first = state.done if n_first is None else n_first
            show(progress_line(state, state.done - n_first, time.monotonic() - start_s))

        yield report


def progress_line(state: SweepProgress, n_since: int, seconds: float) -> str:
    """Return one line: number of the point, fraction of finished samples, samples per second, remaining time."""
    rate = n_since / seconds if seconds > 0 else 0.0
    time_left = f"{(state.total - state.done) / rate:.0f} s left" if rate > 0 else "time left unknown"
    points = f"point {state.points + 1} of {state.all_points}, " if state.all_points > 1 else ""
    return f"{points}{state.done / state.total:.0%}, {rate:.3g} samples/s, {time_left}"


def estimate_table(rows: Sequence[Mapping[str, Any]], swept: str | None) -> Table:
    """Return a table of estimates, one row each; vectors are shown as their norms."""
    is_vector = any(isinstance(row["mean"], list) for row in rows)
    numbers = ("|mean|" if is_vector else "mean", "std error", "variance", "reference")
    cells = ((*columns, verdict) for *columns, _, verdict in (estimate_cells(row, bool(swept)) for row in rows))
    heads = ("estimator", *(f">{head}" for head in numbers), "verdict")
    return table_of(*([f">{swept}"] if swept else []), *heads, rows=cells)


def _size(value: float | list[float] | None) -> float | None:
    if value is None or isinstance(value, float):
        return value
    return float(np.linalg.norm(value))


def estimate_cells(row: Mapping[str, Any], swept: bool) -> list[str]:
    """Return the swept value, estimator, mean, error, variance, reference, alpha and verdict of a row as text."""
    reference, short_verdict = row["reference"], row["verdict"].partition(" within")[0].partition(" at")[0]
    return [
        *([number(row["value"], 4)] if swept else []),
        row["estimator"],
        number(_size(row["mean"]), 5),
        number(_size(row["standard_error"]), 2),
        number(row["variance_trace"], 3),
        "–" if reference is None else number(_size(reference), 5),
        "" if row["alpha"] is None else number(row["alpha"], 3),
        "too wide" if row["wide"] else short_verdict,
    ]
