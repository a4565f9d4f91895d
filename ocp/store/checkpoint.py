"""What a long study has done so far, on disk, so that the same command goes on from there."""

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

from dynamics.batch.engines.compiler import identity
from ocp.store.atomic import write, write_errors
from ocp.store.json_values import to_json
from ocp.store.provenance import program_digest, versions

EVERY_S = 2.0
"""Seconds between two savings of a run that is under way."""
_LOCK = ".lock"


class Checkpoint:
    """A hidden directory beside the runs of a problem, held by one process while it is entered.

    Its name says what was asked, the ``source`` that it is asked of (a digest of a user's files),
    and the program that does it: where any of them differs, nothing of it is gone on with. Where a
    process that lives holds it, the next one that does the same has a directory of its own; what a
    process left that does not live any more is taken over. Nothing is kept where ``root`` is None.

    A file that cannot be read counts as not written.
    """

    def __init__(self, root: Path | None, problem: str, request: dict[str, Any], source: str = "") -> None:
        asked = _hashed(to_json(request))
        self._asked = f".unfinished-{asked}-"
        # What does it: our own source, versions of what it stands on, the compiler and the CPU.
        program = _hashed({"source": program_digest(), "compiler": identity(), **versions()})
        self._name = f"{self._asked}{source[:12] or 'own'}-{program}"
        self._shelf = None if root is None else root / problem
        self._place: Path | None = None
        self._lock: int | None = None
        self._saved = time.monotonic()
        self.notes: list[str] = []
        """What a person must know of where it goes on from, once it is entered."""

    @classmethod
    def borrowed(cls, place: Path | None) -> Self:
        """The directory ``place`` that another process holds, for one that works for it."""
        made = cls(None, "", {})
        made._place = place
        return made

    @property
    def place(self) -> Path | None:
        """The directory that is held, None where nothing is kept; only inside of ``with``."""
        if self._place is None and self._shelf is not None:
            raise RuntimeError("a checkpoint can only be used inside a 'with' block")
        return self._place

    def __enter__(self) -> Self:
        """Hold the first directory that nobody does; raises InputError where none can be made."""
        if self._shelf is None:
            return self
        with write_errors(f"the checkpoint in {self._shelf}", "another directory with --out"):
            self._place, self._lock, busy = _held(self._shelf, self._name)
        self._saved = time.monotonic()
        self.notes = self._notes(busy)
        return self

    def __exit__(self, *_: object) -> None:
        """Let others go on with it; nothing is left of one that is empty."""
        if self._shelf is None or self._place is None:
            return
        if _empty(self._place):
            _remove(self._place)
        if self._lock is not None:
            os.close(self._lock)
        self._place, self._lock = None, None

    def rows(self, point: int) -> list[dict[str, Any]] | None:
        """Rows of a finished point, None where it was not finished."""
        if self.place is None:
            return None
        try:
            return json.loads((self.place / f"point-{point:05d}.json").read_bytes())
        except (OSError, ValueError):
            return None

    def save_rows(self, point: int, rows: list[dict[str, Any]]) -> None:
        """Keep a finished point; its states are no longer needed."""
        self._write(f"point-{point:05d}.json", json.dumps(rows).encode())
        for state in self.place.glob(f"{point:05d}-*.npz") if self.place else ():
            state.unlink(missing_ok=True)

    def state(self, key: str) -> dict[str, np.ndarray] | None:
        """Arrays of a sampling that was under way, or None."""
        return None if self.place is None else _arrays(self.place / f"{key}.npz")

    def other_states(self, key: str) -> Iterator[dict[str, np.ndarray]]:
        """Arrays of what is under way of the same problem, but was asked for otherwise."""
        for directory in sorted(self._shelf.glob(".unfinished-*")) if self._shelf else ():
            alike = directory.name.startswith(self._asked)
            found = None if alike else _arrays(directory / f"{key}.npz")
            if found is not None:
                yield found

    def due(self) -> bool:
        """Whether the last saving is long enough ago."""
        return time.monotonic() - self._saved >= EVERY_S

    def save_state(self, key: str, **arrays: Any) -> None:
        """Keep the arrays of a sampling that is under way."""
        buffer = io.BytesIO()
        np.savez(buffer, **arrays)
        self._write(f"{key}.npz", buffer.getvalue())
        self._saved = time.monotonic()

    def discard(self) -> None:
        """Remove everything that this process holds: the study is stored as a run."""
        if self.place is not None and self._shelf is not None:
            _remove(self.place)

    def _write(self, name: str, content: bytes) -> None:
        if self.place is not None:
            write(self.place / name, content, "the checkpoint")

    def _notes(self, busy: bool) -> list[str]:
        assert self.place is not None and self._shelf is not None
        notes = []
        if busy:
            notes.append(
                "another process runs the same computation; this one runs independently and gives the same numbers"
            )
        if _empty(self.place):
            notes += self._outdated(self._shelf)
        return notes

    def _outdated(self, shelf: Path) -> Iterator[str]:
        """Say why what was begun by the same words is not gone on with."""
        source, program = _made_of(self._name, self._asked)
        for one in sorted(shelf.glob(f"{self._asked}*")):
            old, by = _made_of(one.name, self._asked)
            if (old, by) == (source, program) or _empty(one):
                continue
            why = (
                "the problem's file, or what it imports, has changed"
                if old != source
                else "the program, or the computer, has changed"
            )
            yield f"{why} since the first run: starting again; earlier results are in {one}"
            return


def _made_of(name: str, asked: str) -> list[str]:
    """Digests of source and program in a directory's name."""
    return name.removeprefix(asked).partition(".")[0].split("-")


def _empty(place: Path) -> bool:
    try:
        return not any(file.name != _LOCK for file in place.iterdir())
    except OSError:
        return True


def _remove(place: Path) -> None:
    """Remove a directory that is held, its lock last: until then nobody else enters it."""
    # Another process may have entered as soon as the lock was gone.
    with suppress(OSError):
        for file in place.iterdir():
            if file.is_dir():
                shutil.rmtree(file, ignore_errors=True)
            elif file.name != _LOCK:
                file.unlink(missing_ok=True)
        (place / _LOCK).unlink(missing_ok=True)
        place.rmdir()


def _held(shelf: Path, name: str) -> tuple[Path, int, bool]:
    """Hold a directory ``name.1``, ``name.2``, ..., old ones first; and whether others hold one."""
    shelf.mkdir(parents=True, exist_ok=True)
    there = sorted(shelf.glob(f"{name}.*"), key=lambda place: (len(place.name), place.name))
    for place in there:
        lock = _entered(place)
        if lock is not None:
            return place, lock, place != there[0]
    for number in itertools.count(1):
        place = shelf / f"{name}.{number}"
        with suppress(FileExistsError):
            place.mkdir()
            lock = _entered(place)
            if lock is not None:
                return place, lock, number > 1
    raise AssertionError


def _entered(place: Path) -> int | None:
    """The lock of a directory, or None where another process holds it or has removed it."""
    try:
        handle = os.open(place / _LOCK, os.O_RDWR | os.O_CREAT, 0o600)
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # It may have been removed between the two.
        if os.path.samestat(os.fstat(handle), (place / _LOCK).stat()):
            return handle
    except (BlockingIOError, FileNotFoundError):
        pass
    except OSError:
        # A file system without locks: as if nobody else were there.
        return handle
    os.close(handle)
    return None


def _arrays(file: Path) -> dict[str, np.ndarray] | None:
    try:
        with np.load(file, allow_pickle=False) as found:
            return dict(found)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None


def _hashed(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:12]
