"""The first lines of the program: they set up Ctrl-C before anything else is imported."""

import os
import sys

from reports.cli import end

# What the module signal wraps: that one imports for 10 ms, in which Ctrl-C would raise a traceback.
_signal = __import__("_signal")


def main() -> int:
    """Run the command that ``sys.argv`` gives and return its exit code.

    Ctrl-C ends the process at once before :mod:`reports.cli.interrupt` takes over, and after it.
    """
    _signal.signal(_signal.SIGINT, end)
    _open_closed()
    from reports.cli.app import main as run

    code = run()
    # What is left is Python's own end, in which a handler of Python's would raise in odd places.
    _signal.signal(_signal.SIGINT, _signal.SIG_DFL)
    return code


def _open_closed() -> None:
    """Point streams that came closed at the null device, so that no file gets their descriptor."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    if sys.stdout is None:
        sys.stdout = os.fdopen(1, "w")
    if sys.stderr is None:
        sys.stderr = os.fdopen(2, "w")
