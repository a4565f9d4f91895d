"""Folders to compile in, inside of a cache that any process may empty at any time."""

from __future__ import annotations

import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_PREFIX = "build-"


@contextmanager
def workshop(directory: Path) -> Iterator[Path]:
    """A folder in ``directory``, gone afterwards; locked, so that :func:`swept` leaves it alone."""
    # Under the directory's own lock, so that none is ever seen that is not locked yet.
    shelf = _lock(directory, wait=True)
    try:
        build = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=directory))
        lock = _lock(build, wait=True)
    finally:
        os.close(shelf)
    try:
        yield build
    finally:
        shutil.rmtree(build, ignore_errors=True)
        os.close(lock)


@contextmanager
def swept(directory: Path) -> Iterator[None]:
    """Remove the folders of killed processes; inside, no other process makes one."""
    shelf = _lock(directory, wait=True)
    try:
        for build in directory.glob(f"{_PREFIX}*"):
            try:
                lock = _lock(build, wait=False)
            except OSError:
                # It is locked, or gone.
                continue
            shutil.rmtree(build, ignore_errors=True)
            os.close(lock)
        yield
    finally:
        os.close(shelf)


def _lock(directory: Path, wait: bool) -> int:
    """Lock a directory; the kernel drops the lock with its process.

    Raises BlockingIOError where another holds it and this one does not ``wait``. A file system
    without locks is used without.
    """
    handle = os.open(directory, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        os.close(handle)
        raise
    except OSError:
        pass
    return handle
