"""Errors that users may meet, each with a sentence and an exit code."""

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
    """A result that could not be written, because of a full disk or an error of the file's format."""

    exit_code = 1


class NotConverged(RuntimeError):
    """A solve or a rollout that did not reach its tolerance; the message says where."""

    exit_code = 3


class DamagedRun(RuntimeError):
    """A run directory that cannot be read back; the message names the file and the reason."""

    exit_code = 4


@contextmanager
def input_errors(*kinds: type[Exception]) -> Iterator[None]:
    """Turn a ValueError, or one of ``kinds``, into an :class:`InputError` with the same message."""
    try:
        yield
    except (ValueError, *kinds) as error:
        raise InputError(str(error)) from error


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt where compiled code has turned it into a SystemError.

    NumPy reads the values of CasADi's matrices in C code; an interrupt makes this code return a result
    with an exception set.
    """
    try:
        yield
    except SystemError as error:
        if isinstance(error.__cause__, KeyboardInterrupt):
            raise error.__cause__ from error
        raise


def choose(kind: str, name: str, known: Mapping[str, T]) -> T:
    """Return ``known[name]``; raise :class:`InputError` with the nearest name and a list where there is none."""
    if name not in known:
        raise InputError(
            f"unknown {kind} {name!r}{did_you_mean(name, known)};"
            f" there {'is' if len(known) == 1 else 'are'} {', '.join(known)}"
        )
    return known[name]
