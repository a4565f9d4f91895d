"""Checkpoints of long studies on disk, from which the same command resumes."""

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
"""Time [s] between two saves of an unfinished run."""
_LOCK_FILE = ".lock"
"""Name of the file in a checkpoint's directory that its process locks."""


class SavedWork:
    """Finished points and arrays of unfinished work in a directory; saves nothing without a directory.

    A file that cannot be read counts as not written.
    """

    def __init__(self, directory: Path | None = None) -> None:
        self._directory = directory
        self._last_save = time.monotonic()

    @property
    def place(self) -> Path | None:
        """Directory of the files, None if nothing is saved."""
        return self._directory

    def rows(self, point: int) -> list[dict[str, Any]] | None:
        """Return the rows of a finished point, None for an unfinished one."""
        if self.place is None:
            return None
        try:
            return json.loads((self.place / f"point-{point:05d}.json").read_bytes())
        except (OSError, ValueError):
            return None

    def save_rows(self, point: int, rows: list[dict[str, Any]]) -> None:
        """Save a finished point and delete its states, which are no longer needed."""
        self._write(f"point-{point:05d}.json", json.dumps(rows).encode())
        for state in self.place.glob(f"{point:05d}-*.npz") if self.place else ():
            state.unlink(missing_ok=True)

    def state(self, key: str) -> dict[str, np.ndarray] | None:
        """Return the saved arrays of unfinished work, or None."""
        return None if self.place is None else _read_arrays(self.place / f"{key}.npz")

    def due(self) -> bool:
        """Return whether the last save is long enough ago; never if nothing is saved."""
        return self.place is not None and time.monotonic() - self._last_save >= SAVE_INTERVAL_S

    def save_state(self, key: str, **arrays: Any) -> None:
        """Save the arrays of unfinished work."""
        if self.place is None:
            return
        buffer = io.BytesIO()
        np.savez(buffer, **arrays)
        self._write(f"{key}.npz", buffer.getvalue())
        self._last_save = time.monotonic()

    def _write(self, name: str, content: bytes) -> None:
        if self.place is not None:
            write_file(self.place / name, content, "the checkpoint")


UNSAVED = SavedWork()
"""Place of work that is not saved."""


class Checkpoint(SavedWork):
    """A hidden directory beside the runs of a problem, locked by one process while it is entered.

    Its name holds digests of the request, of the user's files (``source``) and of the program: if
    any of them differs, nothing is resumed. If a living process holds the directory, the next one
    with the same request uses another; a directory of a process that has ended is taken over.
    Nothing is saved if ``root`` is None.
    """

    def __init__(self, root: Path | None, problem: str, request: dict[str, Any], source: str = "") -> None:
        request_digest = _short_hash(to_json(request))
        self._prefix = f".unfinished-{request_digest}-"
        # The program: our source, the versions of its libraries, the compiler and the CPU.
        program = _short_hash({"source": program_digest(), "compiler": compiler_identity(), **versions()})
        self._name = f"{self._prefix}{source[:12] or 'own'}-{program}"
        self._folder = None if root is None else root / problem
        super().__init__()
        self._lock_handle: int | None = None
        self.notes: list[str] = []
        """Sentences for the user about where it resumes from, once it is entered."""

    @property
    def place(self) -> Path | None:
        """Directory that this process holds, None if nothing is saved; only inside a ``with`` block."""
        if self._directory is None and self._folder is not None:
            raise RuntimeError("a checkpoint can only be used inside a 'with' block")
        return self._directory

    def __enter__(self) -> Self:
        """Lock the first free directory; raise InputError if none can be made."""
        if self._folder is None:
            return self
        with write_errors(f"the checkpoint in {self._folder}", "another directory with --out"):
            self._directory, self._lock_handle, others_hold = _hold_directory(self._folder, self._name)
        self._last_save = time.monotonic()
        self.notes = self._notes(others_hold)
        return self

    def __exit__(self, *_: object) -> None:
        """Release the directory; remove it if it is empty."""
        if self._folder is None or self._directory is None:
            return
        if _is_empty(self._directory):
            _remove_held(self._directory)
        if self._lock_handle is not None:
            os.close(self._lock_handle)
        self._directory, self._lock_handle = None, None

    def other_states(self, key: str) -> Iterator[dict[str, np.ndarray]]:
        """Yield the arrays of unfinished work on the same problem by other requests."""
        for directory in sorted(self._folder.glob(".unfinished-*")) if self._folder else ():
            same_request = directory.name.startswith(self._prefix)
            arrays = None if same_request else _read_arrays(directory / f"{key}.npz")
            if arrays is not None:
                yield arrays

    def discard(self) -> None:
        """Remove the directory, once the study is stored as a run."""
        if self.place is not None and self._folder is not None:
            _remove_held(self.place)

    def _notes(self, others_hold: bool) -> list[str]:
        assert self.place is not None and self._folder is not None
        notes = []
        if others_hold:
            notes.append(
                "another process runs the same computation; this one runs independently and gives the same numbers"
            )
        if _is_empty(self.place):
            notes += self._outdated(self._folder)
        return notes

    def _outdated(self, folder: Path) -> Iterator[str]:
        """Yield the reason why unfinished work by the same request is not resumed."""
        source, program = _digests_in_name(self._name, self._prefix)
        for other in sorted(folder.glob(f"{self._prefix}*")):
            old_source, old_program = _digests_in_name(other.name, self._prefix)
            if (old_source, old_program) == (source, program) or _is_empty(other):
                continue
            cause = (
                "the problem's file, or what it imports, has changed"
                if old_source != source
                else "the program, or the computer, has changed"
            )
            yield f"{cause} since the first run: starting again; earlier results are in {other}"
            return


def _digests_in_name(name: str, asked: str) -> list[str]:
    """Return the digests of source and program in a directory's name."""
    return name.removeprefix(asked).partition(".")[0].split("-")


def _is_empty(place: Path) -> bool:
    try:
        return not any(file.name != _LOCK_FILE for file in place.iterdir())
    except OSError:
        return True


def _remove_held(place: Path) -> None:
    """Remove a directory that this process holds, its lock last: until then no other enters it."""
    # Another process may have entered as soon as the lock was gone.
    with suppress(OSError):
        for file in place.iterdir():
            if file.is_dir():
                shutil.rmtree(file, ignore_errors=True)
            elif file.name != _LOCK_FILE:
                file.unlink(missing_ok=True)
        (place / _LOCK_FILE).unlink(missing_ok=True)
        place.rmdir()


def _hold_directory(folder: Path, name: str) -> tuple[Path, int, bool]:
    """Lock a directory ``name.1``, ``name.2``, ..., old ones first; also return whether others hold one."""
    folder.mkdir(parents=True, exist_ok=True)
    existing = sorted(folder.glob(f"{name}.*"), key=lambda place: (len(place.name), place.name))
    for place in existing:
        handle = _try_lock(place)
        if handle is not None:
            return place, handle, place != existing[0]
    for number in itertools.count(1):
        place = folder / f"{name}.{number}"
        with suppress(FileExistsError):
            place.mkdir()
            handle = _try_lock(place)
            if handle is not None:
                return place, handle, number > 1
    raise AssertionError


def _try_lock(place: Path) -> int | None:
    """Lock a directory; return None if another process holds it or has removed it."""
    try:
        handle = os.open(place / _LOCK_FILE, os.O_RDWR | os.O_CREAT, 0o600)
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # The file may have been removed between the two calls.
        if os.path.samestat(os.fstat(handle), (place / _LOCK_FILE).stat()):
            return handle
    except (BlockingIOError, FileNotFoundError):
        pass
    except OSError:
        # A file system without locks: assume that no other process is there.
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
