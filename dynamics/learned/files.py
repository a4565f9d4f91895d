"""Readers for transitions and models in netCDF files, which contain no code, and for transitions in tables."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.learned.netcdf import check_readable
from dynamics.learned.stored import EWDA, KINDS, TRANSITIONS, plain_value
from dynamics.learned.transitions import Transitions
from dynamics.systems import Signal

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


# Name of the attribute with the checksum.
CHECKSUM_KEY = "checksum"
_HDF_SIGNATURE = b"\x89HDF\r\n\x1a\n"


def read_model(path: Path) -> Any:
    """Return the model in a netCDF file; raise ``ValueError`` for a missing or damaged file or one without a model."""
    return model_of(read_dataset(path), path)


def transitions_of(dataset: xr.Dataset, path: Path) -> Transitions:
    """Return the transitions in ``dataset``, read from the file ``path``; raise ``ValueError`` if it contains none."""
    kind = dataset.attrs["kind"]
    if kind != TRANSITIONS:
        raise ValueError(
            f"{path} holds a model of kind {kind}, not transitions; give what ocp collect wrote, or a table"
        )
    return _from_dataset(Transitions, dataset, path)


def model_of(dataset: xr.Dataset, path: Path) -> Any:
    """Return the model in ``dataset``, read from the file ``path``; raise ``ValueError`` if it contains none."""
    kind = dataset.attrs["kind"]
    if kind == TRANSITIONS:
        raise ValueError(f"{path} holds transitions, not a model; learn one from them: ocp learn")
    from dynamics.learned.ewda import EwdaModel
    from dynamics.learned.mlp import MlpModel

    return _from_dataset(EwdaModel if kind == EWDA else MlpModel, dataset, path)


def _from_dataset(kind: Any, dataset: xr.Dataset, path: Path) -> Any:
    try:
        return kind.from_dataset(dataset)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def read_dataset(path: Path) -> xr.Dataset:
    """Return the dataset in a file of transitions or of a model, after a check of its checksum.

    Raises ``ValueError`` if the file is missing, truncated, changed, or of another kind.
    """
    import xarray as xr

    if not path.is_file():
        problem = "is a directory" if path.is_dir() else "file not found"
        raise ValueError(f"{path}: {problem}; ocp collect writes data and ocp learn writes models")
    with path.open("rb") as file:
        if file.read(len(_HDF_SIGNATURE)) != _HDF_SIGNATURE:
            raise ValueError(f"{path} is not a netCDF file; ocp collect writes data and ocp learn writes models")
    try:
        content = path.read_bytes()
        check_readable(content)
        dataset = xr.load_dataset(content, engine="netcdf4", mask_and_scale=False, decode_times=False)
    except MemoryError:
        raise
    except Exception as error:
        raise ValueError(f"{path} is truncated or damaged: {error}; create it again") from error
    kind = plain_value(dataset.attrs.get("kind"))
    if kind not in KINDS:
        raise ValueError(f"{path} is not a file of this program: its kind is {kind!r}, expected {', '.join(KINDS)}")
    if plain_value(dataset.attrs.get(CHECKSUM_KEY)) != checksum(dataset):
        raise ValueError(f"{path} does not match its checksum: truncated or changed; create it again")
    return dataset


def checksum(dataset: xr.Dataset) -> str:
    """Return the SHA-256 of a dataset's names, shapes, values and attributes, without the attribute ``checksum``."""
    digest = hashlib.sha256()
    for name in sorted(map(str, dataset.variables)):
        values = np.asarray(dataset.variables[name].values)
        digest.update(json.dumps([name, dataset[name].dims, values.shape], default=str).encode())
        numeric = values.dtype.kind in "biuf"
        text = "" if numeric else json.dumps(values.tolist(), default=str)
        digest.update(values.tobytes() if numeric else text.encode())
    attributes = {key: plain_value(value) for key, value in dataset.attrs.items() if key != CHECKSUM_KEY}
    digest.update(json.dumps(attributes, sort_keys=True).encode())
    return digest.hexdigest()


# File name suffixes of tables that can be read.
TABLE_SUFFIXES = (".csv", ".parquet")
# Suffix of the name of the column with a state's next value.
NEXT_SUFFIX = "_next"
_HEAD_PATTERN = re.compile(r"\s*(?P<name>[^\[\]]*?)\s*(?:\[(?P<unit>[^\[\]]*)\])?\s*")


def read_table(
    path: Path,
    columns: Mapping[str, str] | None = None,
    signals: tuple[Sequence[Signal], Sequence[Signal]] | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> Transitions:
    """Read transitions from a table, one per row, with columns for states, inputs, and ``<state>_next``.

    A column's name may end with its unit, ``ox [m]``. ``columns`` maps names of signals to names of columns that
    differ from them. ``signals`` are the expected states and inputs; without ``signals`` a column with a ``_next``
    column is a state, and the other columns, or only those in ``columns`` if given, are inputs.

    Raises ``ValueError`` for a file that cannot be read, columns that are missing or not numeric,
    units other than the expected ones, and as :meth:`Transitions.from_arrays` does.
    """
    table = _table(path)
    heads = _match_columns(path, [str(head) for head in table.columns], columns or {})
    if signals is None:
        states, inputs = _infer_signals(path, heads, list(columns or heads))
    else:
        states, inputs = signals
    next_states = [Signal(f"{signal.name}{NEXT_SUFFIX}", signal.unit) for signal in states]
    x, u, x_next = (
        _numeric_columns(path, table, [_column(path, heads, signal) for signal in group])
        for group in (states, inputs, next_states)
    )
    full_provenance = {"how": f"read from {path.name}", **(provenance or {})}
    return Transitions.from_arrays(x, u, x_next, states, inputs, full_provenance)


def _table(path: Path) -> pd.DataFrame:
    import pandas as pd

    if path.suffix not in TABLE_SUFFIXES:
        raise ValueError(f"{path}: expected a table, {' or '.join(TABLE_SUFFIXES)}")
    if not path.is_file():
        raise ValueError(f"{path}: file not found")
    if path.suffix == ".parquet":
        return _parquet(path)
    try:
        return pd.read_csv(path, skipinitialspace=True)
    except pd.errors.EmptyDataError as error:
        raise ValueError(f"{path} is empty; the first line must name the columns") from error
    except pd.errors.ParserError as error:
        raise ValueError(f"{path} is not a CSV table: {str(error).splitlines()[-1]}") from error
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is not UTF-8 text, so not a CSV table") from error


def _parquet(path: Path) -> pd.DataFrame:
    try:
        from pyarrow import ArrowException
        from pyarrow.parquet import read_table as read
    except ImportError as error:
        raise ValueError(
            f"{path}: Parquet is read by Arrow, which the extra learn installs: pip install"
            " 'centralpath[learn]'; or write the table as CSV"
        ) from error
    try:
        return read(path).to_pandas(ignore_metadata=True)
    except (ArrowException, OSError) as error:
        raise ValueError(f"{path} is not a complete Parquet file") from error


def _split_head(head: str) -> tuple[str, str | None]:
    """Split the head of a column, such as ``ox [m]``, into name and unit; the unit is None if the head has none."""
    head_match = _HEAD_PATTERN.fullmatch(head)
    return (head_match["name"], head_match["unit"]) if head_match and head_match["name"] else (head, None)


Heads = dict[str, tuple[str, str | None]]
"""Mapping from a signal's name to its column in the table and its unit, None if the column has no unit."""


def _match_columns(path: Path, texts: list[str], columns: Mapping[str, str]) -> Heads:
    heads: Heads = {}
    for text in texts:
        name, unit = _split_head(text)
        if name in heads:
            raise ValueError(f"{path}: two columns are called {name}; rename one")
        heads[name] = text, unit
    heads_by_signal = dict(heads)
    for name, column in columns.items():
        head = heads.get(_split_head(column)[0])
        if head is None or column not in (head[0], _split_head(head[0])[0]):
            raise ValueError(f"{path}: no column {column!r} for {name}; available: {', '.join(texts)}")
        heads_by_signal[name] = head
    return heads_by_signal


def _infer_signals(path: Path, heads: Heads, names: list[str]) -> tuple[tuple[Signal, ...], tuple[Signal, ...]]:
    """Return states and inputs of a table, inferred from the names of its columns."""
    states = [name for name in names if f"{name}{NEXT_SUFFIX}" in names]
    if not states:
        raise ValueError(
            f"{path}: no column is the next state of another; name states such as x and x{NEXT_SUFFIX},"
            f" or map them with columns, of {', '.join(heads)}"
        )
    ends = {f"{name}{NEXT_SUFFIX}" for name in states}
    inputs = [name for name in names if name not in states and name not in ends]
    first, second = (tuple(Signal(name, heads[name][1] or "1") for name in group) for group in (states, inputs))
    return first, second


def _column(path: Path, heads: Heads, signal: Signal) -> str:
    """Return the name of a signal's column; raise ``ValueError`` if it is missing or has another unit."""
    if signal.name not in heads:
        raise ValueError(
            f"{path}: no column for {signal.name} [{signal.unit}]; it has"
            f" {', '.join(heads)}; map one with columns {signal.name}=COLUMN"
        )
    column, unit = heads[signal.name]
    if unit is not None and unit != signal.unit:
        raise ValueError(
            f"{path}: column {column!r} is in {unit}, and {signal.name} is in {signal.unit};"
            " convert it, and name its unit so"
        )
    return column


def _numeric_columns(path: Path, table: pd.DataFrame, columns: list[str]) -> np.ndarray:
    import pandas as pd

    numbers = table[columns].apply(pd.to_numeric, errors="coerce").to_numpy(dtype=float)
    rows, column_indices = np.nonzero(np.isnan(numbers) & table[columns].notna().to_numpy(bool))
    if len(rows):
        row, column = rows[0], columns[column_indices[0]]
        raise ValueError(
            f"{path}: column {column!r} holds {str(table[column].iloc[row])!r} in row {row},"
            " counted from 0, which is not a number"
        )
    return numbers
