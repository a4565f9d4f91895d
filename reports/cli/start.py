"""Entry point of the program, which handles Ctrl-C before it imports anything else."""

import os
import sys

from reports.cli import end

_COLLECTED_AFTER = 20_000
"""New objects after which Python looks for unused cycles. With its usual 700 that takes a quarter of a start-up."""
# The C module behind signal. Importing signal takes 10 ms, during which Ctrl-C would print a traceback.
_signal = __import__("_signal")


def main() -> None:
    """Run the command in ``sys.argv``, and end the process with its exit code.

    Ctrl-C ends the process at once with code 130, except while :mod:`reports.cli.interrupt` handles it.
    """
    _signal.signal(_signal.SIGINT, end)
    _open_closed()
    __import__("gc").set_threshold(_COLLECTED_AFTER)
    # Pydantic would read the entry points of all installed distributions; ours have no plugins of pydantic.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # Factorisations are too small for threads: with two, a solve of half-cheetah took 1.6 times the processor time, and
    # no fewer seconds. Batches have threads of their own.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    code = _run()
    # Python runs no signal handlers while it shuts down, so exit functions run here, and os._exit ends the process.
    __import__("atexit")._run_exitfuncs()
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


def _run() -> int:
    """Run the command and return its exit code: 2, with one sentence, if a file hides a package that options need."""
    try:
        from reports.cli.app import main as run
    except ImportError:
        from reports.cli.failures import hidden_package

        if not (message := hidden_package()):
            raise
        sys.stderr.write(f"error: {message}\n")
        return 2
    return run()


def _open_closed() -> None:
    """Open the null device in place of closed standard streams, so that no file gets their descriptors."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    if sys.stdout is None:
        sys.stdout = os.fdopen(1, "w")
    if sys.stderr is None:
        sys.stderr = os.fdopen(2, "w")
