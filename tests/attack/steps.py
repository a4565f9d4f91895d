"""Faults at the n-th step in which a program changes files.

Python's audit events report every file opened for writing, every new directory, every rename and
every removal before they happen.
"""

from __future__ import annotations

import errno
import os
import signal
import sys
from pathlib import Path
from typing import Any

CHANGES = {
    "os.rename",
    "os.remove",
    "os.mkdir",
    "os.rmdir",
    "os.truncate",
    "os.link",
    "os.symlink",
    "tempfile.mkdtemp",
    "tempfile.mkstemp",
    "shutil.rmtree",
}
"""Audit events that change files; ``open`` is another one if it is for writing."""


def watch(under: str, at: int, what: str, log: str = "") -> None:
    """Let a fault happen at step ``at``, from 1, of changes below the directory ``under``; 0 for none.

    ``what`` is ``kill``, which ends the process as SIGKILL does, or ``full``, which makes this step
    and all later ones that write fail as on a full disk. ``log`` gets the number of the last step.
    """
    state = {"steps": 0, "busy": False}
    counter = os.open(log, os.O_WRONLY | os.O_CREAT) if log else None

    def happened(event: str, given: tuple[Any, ...]) -> None:
        if state["busy"] or not _changes(event, given, under):
            return
        state["busy"] = True
        try:
            state["steps"] += 1
            if counter is not None:
                os.pwrite(counter, f"{state['steps']:9d}".encode(), 0)
            if at and state["steps"] == at and what == "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            takes_room = event not in ("os.remove", "os.rmdir", "shutil.rmtree")
            if at and state["steps"] >= at and what == "full" and takes_room:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(given[0]))
        finally:
            state["busy"] = False

    sys.addaudithook(happened)


def _changes(event: str, given: tuple[Any, ...], under: str) -> bool:
    if event == "open":
        path, mode, flags = given
        writes = flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT) if isinstance(flags, int) else 0
        if not writes and not (isinstance(mode, str) and set(mode) & set("wax+")):
            return False
    elif event in CHANGES:
        path = given[0]
    else:
        return False
    if isinstance(path, bytes):
        path = os.fsdecode(path)
    if not isinstance(path, str | Path):
        # shutil.rmtree removes by a directory's handle, so that the name alone is not a path.
        return event in CHANGES
    full = str(Path(path).absolute())
    relative_to_handle = event in ("os.remove", "os.rmdir") and given[-1] not in (None, -1)
    return relative_to_handle or full.startswith(under)


def counted(log: Path) -> int:
    """Return the number of steps in a program's log."""
    return int(log.read_text() or "0")
