"""Atomic writes of files and directories.

Everything is first written to a hidden directory next to the target, then flushed to disk and renamed, so that
a process killed at any time leaves no partial result. A target that is not a regular file, such as a FIFO or
``/dev/null``, is not replaced; the content is written to it directly.
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

import numpy as np

from ocp.errors import InputError, NotWritten
from ocp.labelled import LabelledArrays

if TYPE_CHECKING:
    import netCDF4

_DRAFT_PREFIX = ".ocp-partial-"
"""Prefix of the names of unfinished files and directories."""
NETCDF_LOCK = threading.Lock()
"""Lock around calls of the netCDF library, which crashes if two threads use it at once."""


def write_file(path: Path, content: bytes, label: str = "") -> None:
    """Write ``content`` to the file ``path`` atomically; raises the errors of :func:`replace_file`."""
    with replace_file(path, label) as draft:
        draft.write_bytes(content)


@contextmanager
def replace_file(path: Path, label: str = "") -> Iterator[Path]:
    """Yield the path of a draft for the caller to write; it replaces ``path`` at the end of the context.

    A replaced file keeps its permissions. If ``path`` is a link, the file to which it points is replaced. If it
    is a device or a FIFO, the content of the draft is copied to it.

    Raises :class:`~ocp.errors.InputError` with the reason if the file cannot be written; ``label`` is the kind
    of file in the message.
    """
    with write_errors(f"{label} {path}".strip()):
        target = replaceable_path(path)
        if target is None:
            with tempfile.TemporaryDirectory(prefix=_DRAFT_PREFIX) as draft_folder:
                draft = Path(draft_folder) / path.name
                yield draft
                # O_CREAT is not set, since it would create a regular file if the target has vanished.
                handle = os.open(path, os.O_WRONLY)  # A FIFO waits for its reader.
                with draft.open("rb") as draft_stream, os.fdopen(handle, "wb") as target_stream:
                    shutil.copyfileobj(draft_stream, target_stream)
            return
        with draft_directory(target.parent) as draft_folder:
            draft = draft_folder / path.name
            yield draft
            with suppress(FileNotFoundError):
                shutil.copymode(target, draft)
            sync_to_disk(draft)
            draft.replace(target)
            sync_to_disk(target.parent)


def replaceable_path(path: Path) -> Path | None:
    """Return the file to replace: ``path`` with links resolved, or None for a device or FIFO.

    Raises OSError for anything else, such as a directory, a socket, a disk or a loop of links.
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
    """Return whether ``path`` is a link to an open file of a process, such as ``/dev/stdout``."""
    link = path
    while link.is_symlink():
        folder = link.parent.resolve()
        if folder.is_relative_to("/proc"):
            return True
        link = folder / link.readlink()
    return False


@contextmanager
def write_errors(target: str, advice: str = "another place") -> Iterator[None]:
    """Context that converts an OSError to an :class:`~ocp.errors.InputError` with the target and a remedy.

    If the disk is full, the error is of the subclass :class:`~ocp.errors.NotWritten`.
    """
    try:
        yield
    except OSError as error:
        error_class, reason, remedy = InputError, error.strerror or str(error), "choose"
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            error_class, reason, remedy = NotWritten, "the disk is full", "free some space or choose"
        raise error_class(f"cannot write {target}: {reason}; {remedy} {advice}") from error


def netcdf_bytes(arrays: LabelledArrays, label: str) -> bytes:
    """Return arrays as the content of a netCDF file, which xarray reads as their dataset; ``label`` names the file.

    Raises :class:`~ocp.errors.NotWritten` if the netCDF library fails.
    """
    import netCDF4

    try:
        with NETCDF_LOCK:
            file = netCDF4.Dataset("arrays", mode="w", memory=1024)
            _write_arrays(file, arrays)
            return bytes(file.close())
    except (RuntimeError, OSError) as error:
        raise NotWritten(
            f"cannot write {label}: the netCDF library says {str(error)!r}; take fewer points, steps"
            " or scenarios, or free some memory"
        ) from error


def _write_arrays(file: netCDF4.Dataset, arrays: LabelledArrays) -> None:
    """Write arrays to a netCDF file; texts become variable-length strings, and truth values bytes, as in xarray."""
    other_coords = sorted(name for name in arrays.coords if arrays.variables[name].dims != (name,))
    file.setncatts({**arrays.attributes, **({"coordinates": " ".join(other_coords)} if other_coords else {})})
    for name, (dims, values, attrs) in arrays.variables.items():
        for dim, size in zip(dims, values.shape, strict=True):
            if dim not in file.dimensions:
                file.createDimension(dim, size)
        is_text, is_truth = values.dtype.kind in "OUS", values.dtype.kind == "b"
        kind = str if is_text else np.int8 if is_truth else values.dtype
        variable = file.createVariable(name, kind, dims)
        variable.setncatts({**attrs, **({"dtype": "bool"} if is_truth else {})})
        variable[...] = values.astype(object if is_text else kind)


@contextmanager
def draft_directory(directory: Path) -> Iterator[Path]:
    """Yield a new draft directory in ``directory``, locked by this process and removed when the context ends."""
    directory.mkdir(parents=True, exist_ok=True)
    folder_lock = _acquire_lock(directory, wait=True)
    try:
        _remove_stale_drafts(directory)
        draft_folder = Path(tempfile.mkdtemp(prefix=_DRAFT_PREFIX, dir=directory))
        draft_lock = _acquire_lock(draft_folder, wait=False)
    finally:
        _release_lock(folder_lock)
    try:
        yield draft_folder
    finally:
        shutil.rmtree(draft_folder, ignore_errors=True)
        _release_lock(draft_lock)


def remove_directory(directory: Path) -> None:
    """Remove a directory atomically: rename it to a hidden name and then delete its files.

    If the process is killed in between, the next process that writes in the parent directory deletes the remaining
    files.
    """
    hidden = directory.with_name(f"{_DRAFT_PREFIX}{directory.name}")
    directory.rename(hidden)
    sync_to_disk(directory.parent)
    # Another process may already be removing it as a stale draft.
    with suppress(FileNotFoundError):
        shutil.rmtree(hidden)


def sync_to_disk(path: Path) -> None:
    """Flush the content of a file, or the names in a directory, to disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        # Some file systems cannot flush a directory; a rename is still atomic there.
        with suppress(OSError) if path.is_dir() else nullcontext():
            os.fsync(handle)
    finally:
        os.close(handle)


def _remove_stale_drafts(directory: Path) -> None:
    """Remove the drafts of killed processes, recognised by their locks, which the kernel has released."""
    for stale in directory.glob(f"{_DRAFT_PREFIX}*"):
        stale_lock = _acquire_lock(stale, wait=False)
        if stale_lock is not None:
            shutil.rmtree(stale, ignore_errors=True)
            _release_lock(stale_lock)


def _acquire_lock(directory: Path, wait: bool) -> int | None:
    """Lock a directory and return its handle, or None if it is already locked or the file system has no locks."""
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


def _release_lock(handle: int | None) -> None:
    if handle is not None:
        os.close(handle)
