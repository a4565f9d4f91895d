"""What ``-v`` and ``-vv`` show: the loggers of our four packages, on stderr."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

PACKAGES = ("dynamics", "ocp", "problems", "reports")


@contextmanager
def shown(verbosity: int) -> Iterator[None]:
    """Print what is logged inside: nothing at 0, INFO at 1, DEBUG from 2 on.

    A line has the seconds since the start of the program, the module and what it says.
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
