"""Writing, reading and listing of stored runs.

A run is a directory ``<root>/<problem>/<utc-time>-<hash>/``, written atomically, with the files of
:mod:`ocp.store.run_files`: ``solution.nc`` (netCDF), ``meta.json``, and ``problem.json`` for a user's
problem. Nothing is pickled, and code that is named in a run is never loaded.
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
from ocp.labelled import LabelledArrays
from ocp.problem.problem import Problem
from ocp.solution import Solution
from ocp.store.atomic import NETCDF_LOCK, draft_directory, netcdf_bytes, sync_to_disk, write_errors
from ocp.store.json_values import content_hash, to_json
from ocp.store.meta import check_meta, check_tags
from ocp.store.provenance import git_revision, versions
from ocp.store.route_record import record_of
from ocp.store.run_files import (
    DATA_FILE,
    META_FILE,
    PROBLEM_FILE,
    error_reason,
    escape_controls,
    read_part,
    read_sealed,
    seal_run,
)
from ocp.store.stored_run import StoredRun
from ocp.validation import expand_path

if TYPE_CHECKING:
    import xarray as xr

SCHEMA = 3
"""Version of the format of ``meta.json``."""


@dataclass(frozen=True)
class RunEntry:
    """Entry in the list of stored runs: the description ``meta``, or in ``damage`` the reason why it cannot be read."""

    path: Path
    meta: dict[str, Any] | None
    damage: str = ""


def save(solution: Solution, root: Path | str, argv: Sequence[str], tags: Sequence[str] = ()) -> StoredRun:
    """Store a solution as a run in ``root`` and return the run; raises the errors of :func:`write_run`."""
    problem, meta = _describe_solution(solution, argv, tags)
    return _write(root, problem, solution.arrays, meta, _parts(solution.problem, solution.arrays))


def in_memory_run(solution: Solution) -> StoredRun:
    """Return the run that :func:`save` would store, without storing it; its path is empty."""
    problem, meta = _describe_solution(solution, [], [])
    description = _complete_meta(problem, solution.arrays, meta, datetime.now(UTC))
    return StoredRun(Path(), solution.arrays, description, _parts(solution.problem, solution.arrays))


def problem_parts(problem: Problem, data: xr.Dataset | None = None) -> dict[str, bytes]:
    """Return a mapping from ``problem.json`` to its content, the description of a user's problem.

    The description includes drawings of the states in ``data``. For a problem of the workbench the mapping is
    empty.
    """
    return _parts(problem, LabelledArrays({}) if data is None else LabelledArrays.of(data))


def _parts(problem: Problem, arrays: LabelledArrays) -> dict[str, bytes]:
    if problem.origin.record is None:
        return {}
    motions = {suffix: arrays[f"x{suffix}"][0] for suffix in ("", "_replay") if f"x{suffix}" in arrays}
    return {PROBLEM_FILE: json.dumps(to_json(problem.origin.record.describe_motions(motions))).encode()}


def _describe_solution(solution: Solution, argv: Sequence[str], tags: Sequence[str] = ()) -> tuple[str, dict[str, Any]]:
    """Return the name of a solution's problem, and its description for ``meta.json``."""
    record = record_of(solution)
    summary_keys = (
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
        "audit": asdict(solution.audit),
        "certificate": asdict(solution.certificate),
        "referee": solution.referee.document,
        **{name: getattr(solution, name) for name in summary_keys},
    }
    return str(record.get("problem", "problem")), meta


def write_run(
    root: Path | str,
    problem: str,
    data: xr.Dataset,
    meta: dict[str, Any],
    parts: Mapping[str, bytes] | None = None,
) -> StoredRun:
    """Store ``data`` and ``meta`` as a run of ``problem`` and return the run.

    ``meta`` contains the entries that :mod:`ocp.store.meta` defines for its ``kind``, and optionally ``tags``;
    ``parts`` are from :func:`problem_parts`. The entries ``schema problem created versions revision hash parts
    checksum`` are added. The hash in the run's name is computed from the content without times and tags, so
    that identical solves have the same hash.

    Raises :class:`~ocp.errors.InputError` for a tag that is not one word, and if the directory
    cannot be written or the disk is full; in this case no partial run is left.
    """
    return _write(root, problem, LabelledArrays.of(data), meta, parts or {})


def _write(
    root: Path | str, problem: str, arrays: LabelledArrays, meta: dict[str, Any], parts: Mapping[str, bytes]
) -> StoredRun:
    created = datetime.now(UTC)
    description = _complete_meta(problem, arrays, meta, created)
    content = netcdf_bytes(arrays, f"the run to {root}")
    files = seal_run(description, {DATA_FILE: content, **parts})
    name = f"{created:%Y%m%dT%H%M%SZ}-{description['hash']}"
    store = expand_path(root)
    problem_folder = store / (re.sub(r"[^\w.-]+", "-", problem).strip(".-") or "problem")
    with _write_errors(store), draft_directory(problem_folder) as draft:
        for file, content in files.items():
            (draft / file).write_bytes(content)
            sync_to_disk(draft / file)
        sync_to_disk(draft)
        run_folder = _rename_into(draft, problem_folder, name)
        sync_to_disk(problem_folder)
    # The description is parsed from the written text, so that it equals that of the run when read back.
    return StoredRun(run_folder, arrays, json.loads(files[META_FILE]), dict(parts))


def _complete_meta(problem: str, arrays: LabelledArrays, meta: dict[str, Any], created: datetime) -> dict[str, Any]:
    description = to_json(meta)
    return description | {
        "schema": SCHEMA,
        "problem": problem,
        "created": created.isoformat(timespec="microseconds"),
        "tags": check_tags(meta.get("tags") or ()),
        "versions": versions(),
        "revision": git_revision(),
        "hash": content_hash(arrays, description),
    }


def check_writable(root: Path | str) -> None:
    """Create the folder ``root`` if needed; raise :class:`~ocp.errors.InputError` if it is not writable."""
    store = expand_path(root)
    with _write_errors(store), draft_directory(store):
        pass


def _write_errors(root: Path) -> AbstractContextManager[None]:
    return write_errors(f"the run to {root}", "another directory with --out")


def load(path: Path | str) -> StoredRun:
    """Read a run and verify the checksums of all its files.

    Raises :class:`~ocp.errors.InputError` if there is no such directory and
    :class:`~ocp.errors.DamagedRun`, with file and reason, if the run is incomplete or changed.
    """
    directory = expand_path(path)
    meta = read_meta(directory)
    parts = {name: read_part(directory, meta, name) for name in meta["parts"]}
    data = _parse_netcdf(directory / DATA_FILE, parts.pop(DATA_FILE))
    return StoredRun(directory, LabelledArrays.of(data), meta, parts)


def _parse_netcdf(file: Path, content: bytes) -> xr.Dataset:
    """Parse the content of a netCDF file; raise :class:`~ocp.errors.DamagedRun` if it is not readable."""
    import xarray as xr

    try:
        with NETCDF_LOCK:
            check_readable(content)
            return _escape_dataset(xr.load_dataset(content, engine="netcdf4"))
    except MemoryError:
        raise
    except Exception as error:
        raise DamagedRun(f"{file} is not a readable netCDF file: {error}") from error


def _escape_dataset(data: xr.Dataset) -> xr.Dataset:
    """Escape control characters in a dataset's texts, since terminals execute them."""
    for name, variable in data.variables.items():
        variable.attrs = escape_controls(variable.attrs)
        if variable.dtype.kind in "OUS":
            escaped = np.vectorize(escape_controls, otypes=[object])(variable.values)
            if not np.array_equal(escaped, variable.values):
                assign = data.assign_coords if name in data.coords else data.assign
                data = assign({name: (variable.dims, escaped, variable.attrs)})
    return data


def read_meta(directory: Path) -> dict[str, Any]:
    """Read and check ``meta.json`` of a run; raises the errors of :func:`load`."""
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
    """Return the directories of all runs under ``root``, oldest first, without opening files.

    Runs are ordered by the time in their names, and runs of the same second by modification time. If a
    problem's directory is unreadable, it is listed instead of its runs.

    Raises :class:`~ocp.errors.InputError` for an unreadable ``root``.
    """
    try:
        problem_folders = _visible_folders(Path(root))
    except FileNotFoundError:
        return []
    except OSError as error:
        raise InputError(f"cannot read the runs in {root}: {error_reason(error)}") from error
    return sorted(
        (path for problem_folder in problem_folders for path in _runs_of_problem(problem_folder)), key=_age_key
    )


def list_runs(root: Path | str) -> list[RunEntry]:
    """Return entries of all runs under ``root``, oldest first, including damaged runs; raises as :func:`run_paths`."""
    return [read_entry(path) for path in run_paths(root)]


def _runs_of_problem(problem_folder: Path) -> list[Path]:
    try:
        return _visible_folders(problem_folder)
    except OSError:
        return [problem_folder]


def read_entry(directory: Path) -> RunEntry:
    """Read the description of a run and verify its checksums; the entry of a damaged run contains the reason."""
    try:
        os.scandir(directory).close()
        meta = read_meta(directory)
        for name in meta["parts"]:
            read_part(directory, meta, name)
    except OSError as error:
        return RunEntry(directory, None, f"{directory} cannot be read: {error_reason(error)}")
    except (DamagedRun, InputError) as error:
        return RunEntry(directory, None, str(error))
    return RunEntry(directory, meta)


def _visible_folders(directory: Path) -> list[Path]:
    """Return the folders in ``directory`` that are not hidden, and entries that cannot be examined, sorted by name."""

    def may_be_visible_folder(entry: os.DirEntry[str]) -> bool:
        try:
            return not entry.name.startswith(".") and entry.is_dir()
        except OSError:
            return True

    with os.scandir(directory) as entries:
        return sorted(Path(entry.path) for entry in entries if may_be_visible_folder(entry))


def _age_key(path: Path) -> tuple[str, int, str]:
    """Return a key that sorts runs by the time in their names, then by modification time."""
    try:
        modified_ns = path.stat().st_mtime_ns
    except OSError:
        modified_ns = 0
    return path.name.partition("-")[0], modified_ns, path.name


def _rename_into(draft: Path, problem_folder: Path, name: str) -> Path:
    """Rename a draft to ``name``, with a number appended if another run has this name; return the new path."""
    attempt = 1
    while True:
        run_folder = problem_folder / (name if attempt == 1 else f"{name}-{attempt}")
        try:
            return draft.rename(run_folder)
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                raise
        attempt += 1
