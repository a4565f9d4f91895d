"""The first lines of the program: Ctrl-C is heeded before anything else is imported."""

import os
import sys

from reports.cli.shell.ending import end

# What the module signal wraps: that one imports for 10 ms, in which nobody hears Ctrl-C.
_signal = __import__("_signal")


def main() -> int:
    """Run the command that ``sys.argv`` asks for and return its exit code.

    Ctrl-C ends the process at once before :mod:`reports.cli.shell.interrupt` listens, and after it.
    """
    _signal.signal(_signal.SIGINT, end)
    _open_closed()
    from reports.cli.app import main as run

    code = run()
    # What is left is Python's own end, in which a handler of Python's would raise in odd places.
    _signal.signal(_signal.SIGINT, _signal.SIG_DFL)
    return code


def _open_closed() -> None:
    """Let streams that came closed lead nowhere, before a file of ours gets their descriptor."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    if sys.stdout is None:
        sys.stdout = os.fdopen(1, "w")
    if sys.stderr is None:
        sys.stderr = os.fdopen(2, "w")
