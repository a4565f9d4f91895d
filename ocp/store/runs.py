"""The run store: what was asked and what came out, on disk, whole or not at all.

A run is ``<root>/<problem>/<utc-time>-<hash>/`` with the files of :mod:`ocp.store.run_files`:
``solution.nc`` (netCDF), ``meta.json``, and of a user's own problem ``problem.json``. It is data:
nothing is ever pickled, and no code that it names is ever loaded.
"""

from __future__ import annotations

import errno
import json
import os
import re
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.learned.netcdf import check_readable
from ocp.errors import DamagedRun, InputError
from ocp.problem.problem import Problem
from ocp.solution import Solution
from ocp.store.atomic import NETCDF, draft_directory, flush, netcdf, write_errors
from ocp.store.json_values import content_hash, to_json
from ocp.store.meta import check_meta, check_tags
from ocp.store.provenance import git_revision, versions
from ocp.store.route_record import record_of
from ocp.store.run_files import (
    DATA_FILE,
    META_FILE,
    PROBLEM_FILE,
    part,
    read_sealed,
    reason,
    sealed,
    visible,
)
from ocp.store.stored_run import StoredRun
from ocp.validation import expand_path

if TYPE_CHECKING:
    import xarray as xr

SCHEMA = 3


@dataclass(frozen=True)
class RunEntry:
    """One line of a store's listing: ``meta`` of a run, or why it cannot be read."""

    path: Path
    meta: dict[str, Any] | None
    damage: str = ""


def save(solution: Solution, root: Path | str, argv: Sequence[str], tags: Sequence[str] = ()) -> StoredRun:
    """Store a solution and return the run; raises as :func:`write` does."""
    problem, data, meta = _parts(solution, argv, tags)
    return write(root, problem, data, meta, problem_part(solution.problem, data))


def in_memory_run(solution: Solution) -> StoredRun:
    """The run that :func:`save` would store, for whatever shows a run; it has no place on disk."""
    problem, data, meta = _parts(solution, [], [])
    described = _completed(problem, data, meta, datetime.now(UTC))
    return StoredRun(Path(), data, described, problem_part(solution.problem, data))


def problem_part(problem: Problem, data: xr.Dataset | None = None) -> dict[str, bytes]:
    """The part of a run that tells of a user's own problem, drawn at the states of ``data``.

    No part for a problem that has a name, or none.
    """
    if problem.origin.record is None:
        return {}
    motions = (
        {}
        if data is None
        else {suffix: np.asarray(data[f"x{suffix}"].values[0]) for suffix in ("", "_replay") if f"x{suffix}" in data}
    )
    return {PROBLEM_FILE: json.dumps(to_json(problem.origin.record.told(motions))).encode()}


def _parts(solution: Solution, argv: Sequence[str], tags: Sequence[str] = ()) -> tuple[str, xr.Dataset, dict[str, Any]]:
    """Name of the problem, arrays and description of a solution."""
    record = record_of(solution)
    summary = (
        "idle_cost",
        "grade",
        "cost",
        "verdict",
        "iterations",
        "build_s",
        "solve_s",
        "evaluation_s",
        "solver_s",
    )
    judged = ("audit", "certificate", "referee")
    meta = {
        "kind": "solve",
        "argv": list(argv),
        "tags": tags,
        "seed": record.get("seed"),
        "record": record,
        "source_digest": solution.problem.origin.source_digest,
        "status": solution.status.label,
        "stages": [asdict(stage) for stage in solution.stages],
        "others": [asdict(attempt) for attempt in solution.route.attempts],
        **{name: asdict(getattr(solution, name)) for name in judged},
        **{name: getattr(solution, name) for name in summary},
    }
    return str(record.get("problem", "problem")), solution.data, meta


def write(
    root: Path | str,
    problem: str,
    data: xr.Dataset,
    meta: dict[str, Any],
    parts: Mapping[str, bytes] | None = None,
) -> StoredRun:
    """Store ``data`` and ``meta`` as one run of ``problem`` and return the run.

    ``meta`` has the entries that :mod:`ocp.store.meta` lists for its ``kind``; ``tags`` mark the
    run; ``parts`` come from :func:`problem_part`. Added are ``schema problem created versions
    revision hash parts checksum``. The hash in the name covers the content without times and tags,
    so identical solves share it.

    Raises :class:`~ocp.errors.InputError` for a tag that is no word, and where the directory cannot
    be written or the disk is full; then nothing of the run is left behind.
    """
    created = datetime.now(UTC)
    described = _completed(problem, data, meta, created)
    content = netcdf(data, f"the run to {root}")
    files = sealed(described, {DATA_FILE: content, **(parts or {})})
    name = f"{created:%Y%m%dT%H%M%SZ}-{described['hash']}"
    place = expand_path(root)
    shelf = place / (re.sub(r"[^\w.-]+", "-", problem).strip(".-") or "problem")
    with _write_errors(place), draft_directory(shelf) as room:
        for file, content in files.items():
            (room / file).write_bytes(content)
            flush(room / file)
        flush(room)
        final = _rename_into(room, shelf, name)
        flush(shelf)
    # Read from the text that was written: a page of this run and of the stored one are the same.
    return StoredRun(final, data, json.loads(files[META_FILE]), dict(parts or {}))


def _completed(problem: str, data: xr.Dataset, meta: dict[str, Any], created: datetime) -> dict[str, Any]:
    described = to_json(meta)
    return described | {
        "schema": SCHEMA,
        "problem": problem,
        "created": created.isoformat(timespec="microseconds"),
        "tags": check_tags(meta.get("tags") or ()),
        "versions": versions(),
        "revision": git_revision(),
        "hash": content_hash(data, described),
    }


def check_writable(root: Path | str) -> None:
    """Make ``root`` and raise :class:`~ocp.errors.InputError` where nothing can be written."""
    place = expand_path(root)
    with _write_errors(place), draft_directory(place):
        pass


def _write_errors(root: Path) -> AbstractContextManager[None]:
    return write_errors(f"the run to {root}", "another directory with --out")


def load(path: Path | str) -> StoredRun:
    """Read a run back, every file of it compared with its checksum first.

    Raises :class:`~ocp.errors.InputError` where there is no such directory and
    :class:`~ocp.errors.DamagedRun`, naming file and reason, where the run is not whole.
    """
    directory = expand_path(path)
    meta = read_meta(directory)
    parts = {name: part(directory, meta, name) for name in meta["parts"]}
    data = _arrays(directory / DATA_FILE, parts.pop(DATA_FILE))
    return StoredRun(directory, data, meta, parts)


def _arrays(file: Path, content: bytes) -> xr.Dataset:
    """The dataset in the bytes of a netCDF file, which are as they were written."""
    import xarray as xr

    try:
        with NETCDF:
            check_readable(content)
            return _visible(xr.load_dataset(content, engine="netcdf4"))
    except MemoryError:
        raise
    except Exception as error:
        raise DamagedRun(f"{file} is not a readable netCDF file: {error}") from error


def _visible(data: xr.Dataset) -> xr.Dataset:
    """The same with texts that a terminal shows and does not obey."""
    for name, variable in data.variables.items():
        variable.attrs = visible(variable.attrs)
        if variable.dtype.kind in "OUS":
            words = np.vectorize(visible, otypes=[object])(variable.values)
            if not np.array_equal(words, variable.values):
                put = data.assign_coords if name in data.coords else data.assign
                data = put({name: (variable.dims, words, variable.attrs)})
    return data


def read_meta(directory: Path) -> dict[str, Any]:
    """Read ``meta.json`` of a run; raises as :func:`load` does."""
    if not directory.is_dir():
        raise InputError(f"there is no run at {directory}; ocp runs lists what the store holds")
    meta, file = read_sealed(directory), directory / META_FILE
    if "schema" not in meta:
        raise DamagedRun(f"{file} has no schema version")
    if meta["schema"] != SCHEMA:
        raise DamagedRun(
            f"{file} has schema version {meta['schema']}, this program reads {SCHEMA}; read it with"
            " the program that wrote it"
        )
    check_meta(file, meta)
    return meta


def run_paths(root: Path | str) -> list[Path]:
    """Folders of all runs under ``root``, oldest first, by their names; no file is opened.

    Runs of the same second are in the order in which their folders were filled. A folder of a
    problem that cannot be read stands for its runs.

    Raises :class:`~ocp.errors.InputError` for a ``root`` that cannot be read.
    """
    try:
        shelves = _folders(Path(root))
    except FileNotFoundError:
        return []
    except OSError as error:
        raise InputError(f"cannot read the runs in {root}: {reason(error)}") from error
    return sorted((path for shelf in shelves for path in _shelved(shelf)), key=_age)


def list_runs(root: Path | str) -> list[RunEntry]:
    """Read all runs under ``root``, oldest first, the damaged ones with the reason.

    Each is judged alone; raises as :func:`run_paths` does.
    """
    return [read_entry(path) for path in run_paths(root)]


def _shelved(shelf: Path) -> list[Path]:
    try:
        return _folders(shelf)
    except OSError:
        return [shelf]


def read_entry(directory: Path) -> RunEntry:
    """Read the description of a run, and compare its files with their checksums."""
    try:
        os.scandir(directory).close()
        meta = read_meta(directory)
        for name in meta["parts"]:
            part(directory, meta, name)
    except OSError as error:
        return RunEntry(directory, None, f"{directory} cannot be read: {reason(error)}")
    except (DamagedRun, InputError) as error:
        return RunEntry(directory, None, str(error))
    return RunEntry(directory, meta)


def _folders(directory: Path) -> list[Path]:
    """Folders in a folder that are not hidden, by name; also what cannot be known to be none."""

    def may_be(entry: os.DirEntry[str]) -> bool:
        try:
            return not entry.name.startswith(".") and entry.is_dir()
        except OSError:
            return True

    with os.scandir(directory) as found:
        return sorted(Path(entry.path) for entry in found if may_be(entry))


def _age(path: Path) -> tuple[str, int, str]:
    """Sorts runs by when they were stored: the second by the name, the rest as written."""
    try:
        written = path.stat().st_mtime_ns
    except OSError:
        written = 0
    return path.name.partition("-")[0], written, path.name


def _rename_into(partial: Path, shelf: Path, name: str) -> Path:
    """Rename to ``name``, with a number where an identical run was stored in the same second."""
    attempt = 1
    while True:
        final = shelf / (name if attempt == 1 else f"{name}-{attempt}")
        try:
            return partial.rename(final)
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                raise
        attempt += 1
