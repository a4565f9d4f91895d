"""The run store: what was asked and what came out, on disk, whole or not at all.

A run is ``<root>/<problem>/<utc-time>-<hash>/`` with ``solution.nc`` (netCDF) and ``meta.json``.
Nothing is ever pickled.
"""

from __future__ import annotations

import errno
import hashlib
import json
import re
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ocp.errors import DamagedRun, InputError
from ocp.solution import Solution
from ocp.store.atomic import drafts, flush, told
from ocp.store.plain import content_hash, plain
from ocp.store.provenance import git_revision, versions
from ocp.store.stored_run import DATA_FILE, META_FILE, StoredRun
from ocp.store.tags import checked

if TYPE_CHECKING:
    import xarray as xr

SCHEMA = 1


@dataclass(frozen=True)
class RunEntry:
    """One line of a store's listing: ``meta`` of a run, or why it cannot be read."""

    path: Path
    meta: dict[str, Any] | None
    damage: str = ""


def save(
    solution: Solution, root: Path | str, argv: Sequence[str], tags: Sequence[str] = ()
) -> Path:
    """Store a solution and return its run directory; see :func:`write` for what it raises."""
    return write(root, *_parts(solution, argv, tags))


def unsaved(solution: Solution) -> StoredRun:
    """The run that :func:`save` would store, for whatever shows a run; it has no place on disk."""
    problem, data, meta = _parts(solution, [], [])
    return StoredRun(Path(), data, _completed(problem, data, meta, datetime.now(UTC)))


def _parts(
    solution: Solution, argv: Sequence[str], tags: Sequence[str] = ()
) -> tuple[str, xr.Dataset, dict[str, Any]]:
    """Name of the problem, arrays and description of a solution."""
    record = dict(solution.record)
    told = ("idle_cost", "grade", "cost", "verdict", "iterations", "build_s", "solve_s",
            "evaluation_s", "solver_s", "others")  # fmt: skip
    judged = ("audit", "certificate", "referee")
    meta = {
        "kind": "solve",
        "argv": list(argv),
        "tags": tags,
        "seed": record.get("seed"),
        "record": record,
        "source_digest": solution.problem.source_digest,
        "status": solution.status.label,
        "stages": [asdict(stage) for stage in solution.stages],
        **{name: asdict(getattr(solution, name)) for name in judged},
        **{name: getattr(solution, name) for name in told},
    }
    return str(record.get("problem", "problem")), solution.data, meta


def write(root: Path | str, problem: str, data: xr.Dataset, meta: dict[str, Any]) -> Path:
    """Store ``data`` and ``meta`` as one run of ``problem`` and return its directory.

    ``meta`` needs ``kind`` and may have ``tags``, words that mark the run; ``schema problem created
    versions revision hash checksum`` are added. The hash in the name covers the content without
    times and tags, so identical solves share it.

    Raises :class:`~ocp.errors.InputError` for a tag that is no word, and where the directory cannot
    be written or the disk is full; then nothing of the run is left behind.
    """
    data_bytes = bytes(data.to_netcdf(engine="netcdf4"))
    created = datetime.now(UTC)
    described = _completed(problem, data, meta, created)
    described["checksum"] = hashlib.sha256(data_bytes).hexdigest()
    meta_bytes = (json.dumps(described, indent=1, sort_keys=True) + "\n").encode()
    name = f"{created:%Y%m%dT%H%M%SZ}-{described['hash']}"
    shelf = Path(root) / (re.sub(r"[^\w.-]+", "-", problem).strip(".-") or "problem")
    with _told(Path(root)), drafts(shelf) as room:
        for file, content in ((DATA_FILE, data_bytes), (META_FILE, meta_bytes)):
            (room / file).write_bytes(content)
            flush(room / file)
        flush(room)
        final = _rename_into(room, shelf, name)
        flush(shelf)
    return final


def _completed(
    problem: str, data: xr.Dataset, meta: dict[str, Any], created: datetime
) -> dict[str, Any]:
    described = plain(meta)
    return described | {
        "schema": SCHEMA,
        "problem": problem,
        "created": created.isoformat(timespec="microseconds"),
        "tags": checked(meta.get("tags") or ()),
        "versions": versions(),
        "revision": git_revision(),
        "hash": content_hash(data, described),
    }


def check_writable(root: Path | str) -> None:
    """Make ``root`` and raise :class:`~ocp.errors.InputError` where nothing can be written."""
    with _told(Path(root)), drafts(Path(root)):
        pass


def _told(root: Path) -> AbstractContextManager[None]:
    return told(f"the run to {root}", "another directory with --out")


def load(path: Path | str) -> StoredRun:
    """Read a run back.

    Raises :class:`~ocp.errors.InputError` where there is no such directory and
    :class:`~ocp.errors.DamagedRun`, naming file and reason, where the run is not whole.
    """
    import xarray as xr

    directory = Path(path)
    meta = read_meta(directory)
    file = directory / DATA_FILE
    try:
        content = file.read_bytes()
    except OSError as error:
        raise DamagedRun(f"{file} cannot be read: {_reason(error)}") from error
    if hashlib.sha256(content).hexdigest() != meta["checksum"]:
        raise DamagedRun(f"{file} does not match its checksum in {META_FILE}: cut short or changed")
    try:
        data = xr.load_dataset(file, engine="netcdf4")
    except (OSError, RuntimeError, ValueError) as error:
        raise DamagedRun(f"{file} is no readable netCDF file: {error}") from error
    return StoredRun(directory, data, meta)


def read_meta(directory: Path) -> dict[str, Any]:
    """Read ``meta.json`` of a run; raises as :func:`load` does."""
    file = directory / META_FILE
    if not directory.is_dir():
        raise InputError(f"there is no run at {directory}; ocp runs lists what the store holds")
    try:
        meta = json.loads(file.read_bytes())
    except OSError as error:
        raise DamagedRun(f"{file} cannot be read: {_reason(error)}") from error
    except ValueError as error:
        raise DamagedRun(f"{file} is not JSON: {error}") from error
    if not isinstance(meta, dict) or "schema" not in meta:
        raise DamagedRun(f"{file} has no schema version, so it describes no run")
    if meta["schema"] != SCHEMA:
        raise DamagedRun(
            f"{file} has schema version {meta['schema']}, this program reads {SCHEMA}; read it with"
            " the program that wrote it"
        )
    missing = sorted({"kind", "problem", "created", "hash", "checksum"} - set(meta))
    if missing:
        raise DamagedRun(f"{file} lacks {', '.join(missing)}")
    return meta


def list_runs(root: Path | str) -> list[RunEntry]:
    """List all runs under ``root``, oldest first, the damaged ones with the reason.

    Runs of the same second are in order too, but for damaged ones, which then come first.
    """
    entries = []
    for directory in sorted(Path(root).glob("*/*"), key=lambda path: (path.name, path)):
        if not directory.is_dir() or directory.name.startswith("."):
            continue
        try:
            entries.append(RunEntry(directory, read_meta(directory)))
        except DamagedRun as error:
            entries.append(RunEntry(directory, None, str(error)))
    return sorted(entries, key=_age)


def _age(entry: RunEntry) -> tuple[str, str]:
    """Sorts runs by when they were stored: the second by the name, the rest as described."""
    return entry.path.name.partition("-")[0], (entry.meta or {}).get("created", "")


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


def _reason(error: OSError) -> str:
    return error.strerror or str(error)
