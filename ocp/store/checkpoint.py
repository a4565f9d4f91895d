"""What a long study has done so far, on disk, so that the same command goes on from there."""

from __future__ import annotations

import hashlib
import io
import json
import shutil
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ocp.store.atomic import write
from ocp.store.plain import plain

EVERY_S = 2.0
"""Seconds between two savings of a run that is under way."""


class Checkpoint:
    """A hidden directory beside the runs of a problem, named after what was asked.

    A file that cannot be read counts as not written.
    """

    def __init__(self, root: Path, problem: str, request: dict[str, Any]) -> None:
        text = json.dumps(plain(request), sort_keys=True)
        name = hashlib.sha256(text.encode()).hexdigest()[:16]
        self._directory = root / problem / f".unfinished-{name}"
        self._saved = time.monotonic()

    def rows(self, point: int) -> list[dict[str, Any]] | None:
        """Rows of a finished point, None where it was not finished."""
        try:
            return json.loads(self._file(f"point-{point:05d}.json").read_bytes())
        except (OSError, ValueError):
            return None

    def save_rows(self, point: int, rows: list[dict[str, Any]]) -> None:
        """Keep a finished point; its states are no longer needed."""
        self._write(f"point-{point:05d}.json", json.dumps(rows).encode())
        for state in self._directory.glob(f"{point:05d}-*.npz"):
            state.unlink(missing_ok=True)

    def state(self, key: str) -> dict[str, np.ndarray] | None:
        """Arrays of a sampling that was under way, or None."""
        return _arrays(self._file(f"{key}.npz"))

    def others(self, key: str) -> Iterator[dict[str, np.ndarray]]:
        """Arrays of what is under way of the same problem, but was asked for otherwise."""
        for directory in sorted(self._directory.parent.glob(".unfinished-*")):
            found = None if directory == self._directory else _arrays(directory / f"{key}.npz")
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
        """Remove everything: the study is stored as a run."""
        shutil.rmtree(self._directory, ignore_errors=True)

    def _file(self, name: str) -> Path:
        return self._directory / name

    def _write(self, name: str, content: bytes) -> None:
        write(self._file(name), content, "what is done to")


def _arrays(file: Path) -> dict[str, np.ndarray] | None:
    try:
        with np.load(file, allow_pickle=False) as found:
            return dict(found)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
