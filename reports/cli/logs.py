"""The output of ``-v`` and ``-vv``: the loggers of our four packages, on stderr."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

PACKAGES = ("dynamics", "ocp", "problems", "reports")


@contextmanager
def libraries_silenced(quiet: bool) -> Iterator[None]:
    """Print warnings of our own packages as one line each, none where ``quiet``.

    Warnings and logs of libraries are hidden, for a user cannot act on them (matplotlib on a
    read-only home, say); ``python -W error`` still finds them.
    """
    import logging
    import warnings

    nowhere = logging.NullHandler()
    # A root without a handler has every library's warnings printed.
    logging.getLogger().addHandler(nowhere)
    printed = set[str]()

    def show(message: Warning | str, category: type[Warning], *_: object) -> None:
        if category.__module__.partition(".")[0] in PACKAGES and str(message) not in printed:
            printed.add(str(message))
            if not quiet:
                print(f"warning: {message}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.showwarning = show
        try:
            yield
        finally:
            logging.getLogger().removeHandler(nowhere)


@contextmanager
def log_to_stderr(verbosity: int) -> Iterator[None]:
    """Print log records inside: none at 0, INFO at 1, DEBUG from 2 on.

    A line has the milliseconds since the start of the program, the module and the message.
    """
    if verbosity <= 0:
        yield
        return
    import logging

    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter(_FORMAT, style="{"))
    loggers = [logging.getLogger(name) for name in PACKAGES]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.addHandler(handler)
        logger.setLevel(logging.INFO if verbosity == 1 else logging.DEBUG)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.removeHandler(handler)
            logger.setLevel(level)


_FORMAT = "{relativeCreated:9.0f} ms  {name}: {message}"
