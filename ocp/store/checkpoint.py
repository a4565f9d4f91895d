"""Checkpoints of long computations on disk, from which the same command resumes after an interruption."""

from __future__ import annotations

import fcntl
import hashlib
import io
import itertools
import json
import os
import shutil
import time
import zipfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import numpy as np

from dynamics.batch.engines.compiler import compiler_identity
from ocp.store.atomic import write_errors, write_file
from ocp.store.json_values import to_json
from ocp.store.provenance import program_digest, versions

SAVE_INTERVAL_S = 2.0
"""Minimum time [s] between two saves of unfinished work."""
_LOCK_FILE = ".lock"
"""Name of the file in a checkpoint's directory that is locked by the process using the directory."""


class SavedWork:
    """Storage of finished points and of arrays of unfinished work in a directory; without a directory nothing is saved.

    A file that cannot be read is treated as missing.
    """

    def __init__(self, directory: Path | None = None) -> None:
        self._directory = directory
        self._last_save = time.monotonic()

    @property
    def directory(self) -> Path | None:
        """Directory of the files, or None if nothing is saved."""
        return self._directory

    def rows(self, point: int) -> list[dict[str, Any]] | None:
        """Return the rows of a finished point, or None if it is unfinished."""
        if self.directory is None:
            return None
        try:
            return json.loads((self.directory / f"point-{point:05d}.json").read_bytes())
        except (OSError, ValueError):
            return None

    def save_rows(self, point: int, rows: list[dict[str, Any]]) -> None:
        """Save the rows of a finished point, and delete its arrays of unfinished work."""
        self._write(f"point-{point:05d}.json", json.dumps(rows).encode())
        for state in self.directory.glob(f"{point:05d}-*.npz") if self.directory else ():
            state.unlink(missing_ok=True)

    def state(self, key: str) -> dict[str, np.ndarray] | None:
        """Return the arrays of unfinished work saved under ``key``, or None if there are none."""
        return None if self.directory is None else _read_arrays(self.directory / f"{key}.npz")

    def due(self) -> bool:
        """Return whether it is time to save again; False if there is no directory."""
        return self.directory is not None and time.monotonic() - self._last_save >= SAVE_INTERVAL_S

    def save_state(self, key: str, **arrays: Any) -> None:
        """Save the arrays of unfinished work under ``key``."""
        if self.directory is None:
            return
        buffer = io.BytesIO()
        np.savez(buffer, **arrays)
        self._write(f"{key}.npz", buffer.getvalue())
        self._last_save = time.monotonic()

    def _write(self, name: str, content: bytes) -> None:
        if self.directory is not None:
            write_file(self.directory / name, content, "the checkpoint")


UNSAVED = SavedWork()
"""Storage that saves nothing."""


class Checkpoint(SavedWork):
    """Storage of a computation's unfinished work, in a hidden directory next to the runs of a problem.

    A checkpoint is a context manager that locks the directory. The directory's name contains digests of the
    request, of the user's files (``source``) and of the program, so that work is resumed only if none of these
    has changed. If another process has locked the directory, a new directory is used; the directory of a
    process that has ended is used again. Nothing is saved if ``root`` is None.
    """

    def __init__(self, root: Path | None, problem: str, request: dict[str, Any], source: str = "") -> None:
        request_digest = _short_hash(to_json(request))
        self._prefix = f".unfinished-{request_digest}-"
        # The program is identified by its source, the versions of its libraries, the compiler and the CPU.
        program = _short_hash({"source": program_digest(), "compiler": compiler_identity(), **versions()})
        self._name = f"{self._prefix}{source[:12] or 'own'}-{program}"
        self._folder = None if root is None else root / problem
        super().__init__()
        self._lock_handle: int | None = None
        self.notes: list[str] = []
        """Sentences for the user, such as why unfinished work is not resumed; set when the context is entered."""

    @property
    def directory(self) -> Path | None:
        """Directory locked by this process, or None if nothing is saved; only available inside a ``with`` block."""
        if self._directory is None and self._folder is not None:
            raise RuntimeError("a checkpoint can only be used inside a 'with' block")
        return self._directory

    def __enter__(self) -> Self:
        """Lock the first free directory; raise InputError if none can be created."""
        if self._folder is None:
            return self
        with write_errors(f"the checkpoint in {self._folder}", "another directory with --out"):
            self._directory, self._lock_handle, others_run = _lock_directory(self._folder, self._name)
        self._last_save = time.monotonic()
        self.notes = self._notes(others_run)
        return self

    def __exit__(self, *_: object) -> None:
        """Unlock the directory, and remove it if it is empty."""
        if self._folder is None or self._directory is None:
            return
        if _is_empty(self._directory):
            _remove_locked(self._directory)
        if self._lock_handle is not None:
            os.close(self._lock_handle)
        self._directory, self._lock_handle = None, None

    def other_states(self, key: str) -> Iterator[dict[str, np.ndarray]]:
        """Yield the arrays saved under ``key`` by unfinished computations for the same problem with other requests."""
        for directory in sorted(self._folder.glob(".unfinished-*")) if self._folder else ():
            same_request = directory.name.startswith(self._prefix)
            arrays = None if same_request else _read_arrays(directory / f"{key}.npz")
            if arrays is not None:
                yield arrays

    def discard(self) -> None:
        """Remove the checkpoint's directory, after the computation is finished."""
        if self.directory is not None and self._folder is not None:
            _remove_locked(self.directory)

    def _notes(self, others_run: bool) -> list[str]:
        assert self.directory is not None and self._folder is not None
        notes = []
        if others_run:
            notes.append(
                "another process runs the same computation; this one runs independently and gives the same numbers"
            )
        if _is_empty(self.directory):
            notes += self._outdated(self._folder)
        return notes

    def _outdated(self, folder: Path) -> Iterator[str]:
        """Yield a sentence on why unfinished work for the same request is not resumed, if such work exists."""
        source, program = _digests_in_name(self._name, self._prefix)
        for checkpoint in sorted(folder.glob(f"{self._prefix}*")):
            old_source, old_program = _digests_in_name(checkpoint.name, self._prefix)
            if (old_source, old_program) == (source, program) or _is_empty(checkpoint):
                continue
            cause = (
                "the problem's file, or what it imports, has changed"
                if old_source != source
                else "the program, or the computer, has changed"
            )
            yield f"{cause} since the first run: starting again; earlier results are in {checkpoint}"
            return


def _digests_in_name(name: str, prefix: str) -> list[str]:
    """Return the digests of source and program in the name of a checkpoint's directory."""
    return name.removeprefix(prefix).partition(".")[0].split("-")


def _is_empty(directory: Path) -> bool:
    try:
        return not any(file.name != _LOCK_FILE for file in directory.iterdir())
    except OSError:
        return True


def _remove_locked(directory: Path) -> None:
    """Remove a directory that this process has locked; its lock file is removed last, to exclude other processes."""
    # Another process may lock the directory as soon as the lock file is removed.
    with suppress(OSError):
        for file in directory.iterdir():
            if file.is_dir():
                shutil.rmtree(file, ignore_errors=True)
            elif file.name != _LOCK_FILE:
                file.unlink(missing_ok=True)
        (directory / _LOCK_FILE).unlink(missing_ok=True)
        directory.rmdir()


def _lock_directory(folder: Path, name: str) -> tuple[Path, int, bool]:
    """Lock the first free directory ``name.1``, ``name.2``, ...; return it, its lock, and whether another is in use."""
    folder.mkdir(parents=True, exist_ok=True)
    existing = sorted(folder.glob(f"{name}.*"), key=lambda directory: (len(directory.name), directory.name))
    for directory in existing:
        handle = _try_lock(directory)
        if handle is not None:
            return directory, handle, directory != existing[0]
    for number in itertools.count(1):
        directory = folder / f"{name}.{number}"
        with suppress(FileExistsError):
            directory.mkdir()
            handle = _try_lock(directory)
            if handle is not None:
                return directory, handle, number > 1
    raise AssertionError


def _try_lock(directory: Path) -> int | None:
    """Lock a directory and return the handle, or None if another process has locked or removed it."""
    try:
        handle = os.open(directory / _LOCK_FILE, os.O_RDWR | os.O_CREAT, 0o600)
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # The file may have been removed between the two calls.
        if os.path.samestat(os.fstat(handle), (directory / _LOCK_FILE).stat()):
            return handle
    except (BlockingIOError, FileNotFoundError):
        pass
    except OSError:
        # The file system has no locks; assume that no other process uses the directory.
        return handle
    os.close(handle)
    return None


def _read_arrays(file: Path) -> dict[str, np.ndarray] | None:
    try:
        with np.load(file, allow_pickle=False) as arrays:
            return dict(arrays)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def _short_hash(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:12]
