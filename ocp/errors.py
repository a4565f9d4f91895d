"""What can go wrong on the user's side, each with a sentence and an exit code."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from difflib import get_close_matches
from typing import TypeVar

T = TypeVar("T")
_LONGEST = 80
_ALIKE = 0.6
"""Least similarity, of 1, of a name that is proposed."""


class InputError(ValueError):
    """Wrong usage: the message says what was wrong, what was expected and how to mend it."""

    exit_code = 2


class NotWritten(InputError):
    """A result that could not be written, for a full disk or an error of the file's format."""

    exit_code = 1


class NotConverged(RuntimeError):
    """A solve or a rollout that did not reach its tolerance; the message says where."""

    exit_code = 3


class DamagedRun(RuntimeError):
    """A run directory that cannot be read back; the message names the file and the reason."""

    exit_code = 4


@contextmanager
def input_errors(*kinds: type[Exception]) -> Iterator[None]:
    """Turn a ValueError, or one of ``kinds``, into an :class:`InputError` of the same words."""
    try:
        yield
    except (ValueError, *kinds) as error:
        raise InputError(str(error)) from error


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise the KeyboardInterrupt inside again where compiled code made a SystemError of it.

    NumPy asks CasADi's matrices for their values from C, where an interrupt on the way is a result
    with an exception set.
    """
    try:
        yield
    except SystemError as error:
        if isinstance(error.__cause__, KeyboardInterrupt):
            raise error.__cause__ from error
        raise


def abbreviated(value: object) -> str:
    """How ``value`` looks, cut to a line; its type alone where it cannot say so itself."""
    try:
        text = repr(value)
    except Exception:
        return f"an unprintable {type(value).__name__}"
    text = " ".join(text.split())
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return ``" (did you mean 'x'?)"`` for the nearest known name, or nothing if none is near."""
    names = {candidate.lower(): candidate for candidate in known}
    # Of two letters one may be wrong, as mu for nu.
    close = get_close_matches(name.lower(), names, n=1, cutoff=0.5 if len(name) == 2 else _ALIKE)
    return f" (did you mean {names[close[0]]!r}?)" if close else ""


def choose(kind: str, name: str, known: Mapping[str, T]) -> T:
    """Return ``known[name]``; raises :class:`InputError` with the nearest name and the list."""
    if name not in known:
        raise InputError(
            f"unknown {kind} {name!r}{did_you_mean(name, known)};"
            f" there {'is' if len(known) == 1 else 'are'} {', '.join(known)}"
        )
    return known[name]
