"""Errors that users may see, each with a sentence and an exit code."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TypeVar

from dynamics.errors import InputError, abbreviated, did_you_mean

__all__ = [
    "DamagedRun",
    "InputError",
    "NotConverged",
    "NotWritten",
    "abbreviated",
    "choose",
    "did_you_mean",
    "input_errors",
    "interruptible",
]

T = TypeVar("T")


class NotWritten(InputError):
    """Error for a result that could not be written because the disk is full or its format does not allow it."""

    exit_code = 1


class NotConverged(RuntimeError):
    """Error for a solve or a rollout that did not reach its tolerance; the message says where."""

    exit_code = 3


class DamagedRun(RuntimeError):
    """Error for a run directory that cannot be read; the message contains the file and the reason."""

    exit_code = 4


@contextmanager
def input_errors(*kinds: type[Exception]) -> Iterator[None]:
    """Convert a ValueError, or one of ``kinds``, to an :class:`InputError` with the same message."""
    try:
        yield
    except (ValueError, *kinds) as error:
        raise InputError(str(error)) from error


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt if compiled code has converted it to a SystemError.

    NumPy reads values of CasADi's matrices in C code; after an interrupt this code returns a result
    with an exception set.
    """
    try:
        yield
    except SystemError as error:
        if isinstance(error.__cause__, KeyboardInterrupt):
            raise error.__cause__ from error
        raise


def choose(kind: str, name: str, known_names: Mapping[str, T]) -> T:
    """Return ``known[name]``; for an unknown name raise :class:`InputError` with the nearest name and a list of all."""
    if name not in known_names:
        raise InputError(
            f"unknown {kind} {name!r}{did_you_mean(name, known_names)};"
            f" there {'is' if len(known_names) == 1 else 'are'} {', '.join(known_names)}"
        )
    return known_names[name]
