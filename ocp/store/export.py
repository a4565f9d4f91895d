"""A run's numbers in forms that other programs read: CSV and NPZ."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ocp.errors import InputError
from ocp.store import atomic
from ocp.store.stored_run import StoredRun

ROWS = {
    "solve": ("scenario", "node"),
    "continue": ("point", "scenario", "node"),
    "estimate": ("point", "estimator"),
    "train": ("iteration",),
}
"""Dimensions that a CSV has a row for, by the kind of a run; intervals are nodes but the last."""


def rows_of(run: StoredRun) -> tuple[str, ...] | None:
    """Dimensions that the run's CSV has a row for, None where it makes no one table."""
    if run.kind == "sweep":
        return tuple(axis["name"] for axis in run.meta["study"]["axes"])
    return ROWS.get(run.kind)


def check_rows(run: StoredRun) -> None:
    """Raise :class:`~ocp.errors.InputError` for a kind of run that makes no one table."""
    if rows_of(run) is None:
        raise InputError(
            f"{run.path} holds a {run.kind}, whose arrays make no one table; take --format npz"
        )


def write_csv(run: StoredRun, file: Path) -> None:
    """Write the arrays over :data:`ROWS` as one table, units in the head; raises as the store does.

    Numbers keep all their digits; where an array has no value, as an input at the last node, the
    cell is empty. A text that a spreadsheet would run as a formula begins with a quote.
    """
    check_rows(run)
    heads, columns = zip(*_columns(run), strict=True)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(map(_text, heads))
    writer.writerows(zip(*(map(_cell, column) for column in columns), strict=True))
    atomic.write(file, text.getvalue().encode(), "the data to")


def write_npz(run: StoredRun, file: Path) -> None:
    """Write every array and coordinate by name, and the description as JSON in ``meta``."""
    values = {str(name): run.data[name].values for name in run.data.variables}
    # Objects would be pickled.
    arrays: dict[str, Any] = {
        name: each.astype(str) if each.dtype.kind == "O" else each for name, each in values.items()
    }
    content = io.BytesIO()
    np.savez_compressed(content, meta=np.array(json.dumps(run.meta)), **arrays)
    atomic.write(file, content.getvalue(), "the data to")


FORMATS: dict[str, Callable[[StoredRun, Path], None]] = {"csv": write_csv, "npz": write_npz}


def _cell(value: Any) -> str:
    if isinstance(value, float | np.floating):
        return "" if np.isnan(value) else repr(float(value))
    return _text(value) if isinstance(value, str) else str(value)


def _text(value: str) -> str:
    """A quote before what spreadsheets would run as a formula."""
    return f"'{value}" if value[:1] in set("=+-@\t\r") else value


def _columns(run: StoredRun) -> Iterator[tuple[str, list[Any]]]:
    """Head and cells of each column: first what the rows are, then every array over them."""
    data, rows = run.data, rows_of(run) or ()
    shape = tuple(data.sizes[name] for name in rows)
    for place, name in enumerate(rows):
        labels = data[name].values if name in data.coords else np.arange(shape[place])
        others = [axis for axis in range(len(rows)) if axis != place]
        within = np.broadcast_to(np.expand_dims(labels, others), shape)
        yield name, list(within.ravel())
    for name in map(str, [*data.coords, *data.data_vars]):
        if name not in rows and not name.startswith(("lam_g_", "lam_x_", "time_interval")):
            yield from _of_array(data, name, rows, shape)


def _of_array(
    data: Any, name: str, rows: tuple[str, ...], shape: tuple[int, ...]
) -> Iterator[tuple[str, list[Any]]]:
    """Columns of one array, a label each; none of an array that is not over the rows."""
    array = data[name]
    if "interval" in array.dims and "node" in rows:
        after = data.sizes["node"] - data.sizes["interval"]
        array = array.pad(interval=(0, after)).rename(interval="node")
    along = [one for one in rows if one in array.dims]
    across = [one for one in array.dims if one not in rows]
    if not along or len(across) > 1:
        return
    values = array.transpose(*along, *across).values
    missing = tuple(place for place, one in enumerate(rows) if one not in along)
    values = np.expand_dims(values, missing)
    values = np.broadcast_to(values, (*shape, *values.shape[len(rows) :]))
    labels = _labels(data, across[0]) if across else [("", "")]
    for place, (label, own) in enumerate(labels):
        cells = values[..., place] if across else values
        unit = own if array.attrs.get("units", "").startswith("see ") else array.attrs.get("units")
        head = f"{name}.{label}" if label else name
        yield f"{head} [{unit}]" if unit and unit != "1" else head, list(cells.ravel())


def _labels(data: Any, dimension: str) -> list[tuple[str, str]]:
    """Label and unit of every place along a dimension."""
    count = data.sizes[dimension]
    names = data[dimension].values if dimension in data.coords else range(count)
    unit = f"{dimension}_unit"
    units = data[unit].values if unit in data.variables else [""] * count
    return [(str(name), str(one)) for name, one in zip(names, units, strict=True)]
