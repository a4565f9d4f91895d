"""Check, in a child process, whether a netCDF file can be read.

The C libraries do not check a file's addresses and counts: in a damaged file these may cause an
infinite loop or an invalid memory access, which ends the process.
"""

from __future__ import annotations

import math
import os
import resource
import signal
import warnings

import numpy as np

_BASE_CPU_S = 1
"""Limit of the CPU time [s] for reading a small file."""
_BYTES_PER_CPU_S = 20_000_000
"""Number of bytes of a file for which the limit of CPU time increases by one second."""


def check_readable(content: bytes) -> None:
    """Raise ``ValueError`` with the reason unless a child process reads all of ``content``."""
    import netCDF4  # Before the fork: the child opens no file but the null device.

    receiver, sender = os.pipe()
    with warnings.catch_warnings():
        # The warning is about threads, which the child does not need.
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        reason = ""
        try:
            reason = _failure(content, netCDF4)
        except BaseException as error:
            reason = str(error) or type(error).__name__
        finally:
            os.write(sender, reason.encode(errors="replace")[:1000])
            os._exit(0)
    os.close(sender)
    with os.fdopen(receiver, "rb") as pipe:
        reason = pipe.read().decode(errors="replace")
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        end_signal = signal.Signals(os.WTERMSIG(status))
        reason = "reading it takes too long" if end_signal is signal.SIGXCPU else f"{end_signal.name} ends it"
    if reason:
        raise ValueError(reason)


def _failure(content: bytes, library: object) -> str:
    """Read every variable of a file; return the reason why the file is not valid, or ``""`` if it is."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    seconds = _BASE_CPU_S + len(content) // _BYTES_PER_CPU_S
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
    with library.Dataset("checked", memory=content) as dataset:  # pyright: ignore
        variables = dataset.variables.values()
        size = sum(math.prod(v.shape) * np.dtype(v.dtype or object).itemsize for v in variables)
        if size > len(content):
            return f"it claims {size} bytes of numbers and has {len(content)} in all"
        for variable in variables:
            variable[...]
    return ""
