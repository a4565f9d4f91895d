"""Write files and directories whole or not at all.

Everything is made in a hidden directory beside its place, flushed to the disk and renamed, so that
a process killed at any time leaves nothing half written. What is no regular file, as a FIFO or
``/dev/null``, is never replaced: it is written to.
"""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
import stat
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from ocp.errors import InputError, NotWritten

if TYPE_CHECKING:
    import xarray as xr

_PREFIX = ".ocp-partial-"
NETCDF = threading.Lock()
"""The netCDF library crashes where two threads of a process are in it."""


def write(path: Path, content: bytes, what: str = "") -> None:
    """Put ``content`` in the place of ``path``; raises as :func:`replacing` does."""
    with replacing(path, what) as draft:
        draft.write_bytes(content)


@contextmanager
def replacing(path: Path, what: str = "") -> Iterator[Path]:
    """Give the file to fill that then becomes the content of ``path``; it has the same name.

    A regular file is replaced, and keeps its mode; of a link, what it points to. A device or a
    FIFO is written to, once the draft is whole.

    Raises :class:`~ocp.errors.InputError` with the reason where it cannot be written; ``what``
    says what it is.
    """
    with write_errors(f"{what} {path}".strip()):
        place = destination(path)
        if place is None:
            with tempfile.TemporaryDirectory(prefix=_PREFIX) as room:
                draft = Path(room) / path.name
                yield draft
                # No O_CREAT: had it vanished since, a file would be made that is not replaced.
                sink = os.open(path, os.O_WRONLY)  # A FIFO waits for its reader.
                with draft.open("rb") as source, os.fdopen(sink, "wb") as target:
                    shutil.copyfileobj(source, target)
            return
        with draft_directory(place.parent) as room:
            draft = room / path.name
            yield draft
            with suppress(FileNotFoundError):
                shutil.copymode(place, draft)
            flush(draft)
            draft.replace(place)
            flush(place.parent)


def destination(path: Path) -> Path | None:
    """Return where a file called ``path`` lies, links followed; None for what is written into.

    Raises OSError where it is neither: a directory, a socket, a disk, a circle of links.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return path.resolve()
    if stat.S_ISCHR(mode) or stat.S_ISFIFO(mode) or _is_handle(path):
        return None
    if stat.S_ISREG(mode):
        return path.resolve()
    kinds = {stat.S_IFDIR: "it is a directory", stat.S_IFBLK: "it is a disk"}
    raise OSError(errno.EINVAL, kinds.get(stat.S_IFMT(mode), "it is no file"), str(path))


def _is_handle(path: Path) -> bool:
    """Whether it names an open file of a process, as ``/dev/stdout`` does."""
    seen = path
    while seen.is_symlink():
        home = seen.parent.resolve()
        if home.is_relative_to("/proc"):
            return True
        seen = home / seen.readlink()
    return False


@contextmanager
def write_errors(place: str, advice: str = "another place") -> Iterator[None]:
    """Turn an OSError into an :class:`~ocp.errors.InputError` with the place and a way out.

    A full disk raises :class:`~ocp.errors.NotWritten`, which is one too.
    """
    try:
        yield
    except OSError as error:
        kind, reason, mend = InputError, error.strerror or str(error), "choose"
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            kind, reason, mend = NotWritten, "the disk is full", "free some space or choose"
        raise kind(f"cannot write {place}: {reason}; {mend} {advice}") from error


def netcdf(data: xr.Dataset, what: str) -> bytes:
    """The netCDF file of ``data``, made in memory; ``what`` says in errors whose it is.

    Raises :class:`~ocp.errors.NotWritten` where the netCDF library fails.
    """
    try:
        with NETCDF:
            return bytes(data.to_netcdf(engine="netcdf4"))
    except (RuntimeError, OSError) as error:
        raise NotWritten(
            f"cannot write {what}: the netCDF library says {str(error)!r}; take fewer points, steps"
            " or scenarios, or free some memory"
        ) from error


@contextmanager
def draft_directory(directory: Path) -> Iterator[Path]:
    """Make a directory in ``directory`` to write in, locked while its process lives, then gone."""
    directory.mkdir(parents=True, exist_ok=True)
    shelf = _lock(directory, wait=True)
    try:
        _sweep(directory)
        room = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=directory))
        lock = _lock(room, wait=False)
    finally:
        _close(shelf)
    try:
        yield room
    finally:
        shutil.rmtree(room, ignore_errors=True)
        _close(lock)


def discard(directory: Path) -> None:
    """Remove a directory whole: it is hidden first, so that a kill leaves no half of it in sight.

    What a killed process leaves is a draft like others, which the next writer here removes.
    """
    hidden = directory.with_name(f"{_PREFIX}{directory.name}")
    directory.rename(hidden)
    flush(directory.parent)
    # Another may be removing it already, as a draft that nobody holds.
    with suppress(FileNotFoundError):
        shutil.rmtree(hidden)


def flush(path: Path) -> None:
    """Bring a file, or the names in a directory, to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        # Some file systems cannot flush a directory; a rename is still atomic there.
        with suppress(OSError) if path.is_dir() else nullcontext():
            os.fsync(handle)
    finally:
        os.close(handle)


def _sweep(directory: Path) -> None:
    """Remove what killed processes left: the kernel drops a lock with its process."""
    for stale in directory.glob(f"{_PREFIX}*"):
        lock = _lock(stale, wait=False)
        if lock is not None:
            shutil.rmtree(stale, ignore_errors=True)
            _close(lock)


def _lock(directory: Path, wait: bool) -> int | None:
    """Open and lock a directory, or None where another holds it or the file system cannot."""
    try:
        handle = os.open(directory, os.O_RDONLY)
    except OSError:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        os.close(handle)
        return None
    return handle


def _close(handle: int | None) -> None:
    if handle is not None:
        os.close(handle)
