"""Whether a netCDF file can be read at all, found out by a child process.

The C libraries behind netCDF trust a file's own addresses and counts: flipped bits may make them
loop for ever, or touch memory that is not theirs, which ends the process.
"""

from __future__ import annotations

import contextlib
import math
import os
import resource
import signal
import warnings

import numpy as np

_SECONDS, _BYTES_PER_SECOND = 1, 20_000_000
"""CPU seconds that opening and reading may take: these, and one more for so many bytes."""


def check_readable(content: bytes) -> None:
    """Raise ``ValueError`` with the reason unless a child process reads all of ``content``.

    Its limit is one of CPU time, which does not depend on the load of the machine.
    """
    import netCDF4  # Before the fork: the child needs no file but the null device.

    receiver, sender = os.pipe()
    with warnings.catch_warnings():
        # Of threads: the child runs the netCDF library alone, which no other thread may be in.
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        _read_and_exit(content, netCDF4, sender)
    os.close(sender)
    with os.fdopen(receiver, "rb") as pipe:
        reason = pipe.read().decode(errors="replace")
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        ended = signal.Signals(os.WTERMSIG(status))
        endless = ended == signal.SIGXCPU
        reason = "reading it does not end" if endless else f"reading it ends in {ended.name}"
    if reason or status:
        raise ValueError(reason or "reading it fails")


def _read_and_exit(content: bytes, library: object, sender: int) -> None:
    """In the child: read every variable, send the reason of a failure, and end."""
    reason = "reading it fails"
    try:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        signal.signal(signal.SIGXCPU, signal.SIG_DFL)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        seconds = _SECONDS + len(content) // _BYTES_PER_SECOND
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        with library.Dataset("checked", memory=content) as found:  # pyright: ignore
            parts = found.variables.values()
            sizes = [math.prod(v.shape) * np.dtype(v.dtype or object).itemsize for v in parts]
            reason = f"it claims {sum(sizes)} bytes of numbers and has {len(content)} in all"
            if sum(sizes) <= len(content):
                for variable in parts:
                    variable[...]
                reason = ""
    except BaseException as error:
        reason = str(error) or type(error).__name__
    with contextlib.suppress(OSError):
        os.write(sender, reason.encode(errors="replace")[:1000])
    os._exit(0)
