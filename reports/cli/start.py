"""The first lines of the program: they set up Ctrl-C before anything else is imported."""

import os
import sys

from reports.cli import end

# What the module signal wraps: that one imports for 10 ms, in which Ctrl-C would raise a traceback.
_signal = __import__("_signal")


def main() -> None:
    """Run the command that ``sys.argv`` gives, and end the process with its exit code.

    Ctrl-C ends the process at once, with 130, before :mod:`reports.cli.interrupt` takes over and
    after it, up to the last instruction.
    """
    _signal.signal(_signal.SIGINT, end)
    _open_closed()
    from reports.cli.app import main as run

    code = run()
    # Python's own end runs no handlers of signals: the process ends here, once that work is done.
    __import__("atexit")._run_exitfuncs()
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


def _open_closed() -> None:
    """Open the null device for closed standard streams, so that no file gets their descriptors."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    if sys.stdout is None:
        sys.stdout = os.fdopen(1, "w")
    if sys.stderr is None:
        sys.stderr = os.fdopen(2, "w")
