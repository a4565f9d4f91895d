"""Something happens at the n-th step by which a program changes files.

Python's audit events tell of every file that is opened to be written, every directory made, every
rename and every removal, before they happen.
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
"""Events that change names; ``open`` is one too where it is for writing."""


def watch(under: str, at: int, what: str, log: str = "") -> None:
    """At step ``at`` (from 1) below the directory ``under``: ``kill`` or ``full``.

    ``kill`` ends the process as SIGKILL does; ``full`` fails this step and every later one that
    writes or makes something as a full disk does. 0 lets all steps pass. ``log`` is where the
    number of the last step is kept.
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
        # Removed by a directory's handle, as shutil.rmtree does: the name alone tells nothing.
        return event in CHANGES
    full = str(Path(path).absolute())
    relative_to_handle = event in ("os.remove", "os.rmdir") and given[-1] not in (None, -1)
    return relative_to_handle or full.startswith(under)


def counted(log: Path) -> int:
    """Steps that a program took, as its log tells."""
    return int(log.read_text() or "0")
