"""The error of wrong usage, and words that its messages share."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

MAX_SHOWN_CHARACTERS = 80
"""A value that a message shows is cut to this many characters."""
MIN_SIMILARITY = 0.6
"""A name is proposed where its similarity, from 0 to 1, is at least this."""


class InputError(ValueError):
    """Wrong usage: the message says what was wrong, what was expected and how to mend it."""

    exit_code = 2


def abbreviated(value: object) -> str:
    """Return the text of ``value``, cut to a line; its type alone where it has no text."""
    try:
        text = repr(value)
    except Exception:
        return f"an unprintable {type(value).__name__}"
    text = " ".join(text.split())
    return text if len(text) <= MAX_SHOWN_CHARACTERS else f"{text[: MAX_SHOWN_CHARACTERS - 3]}..."


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return ``" (did you mean 'x'?)"`` for the nearest known name, or nothing if none is near."""
    names = {candidate.lower(): candidate for candidate in known}
    # Of two letters one may be wrong, as mu for nu.
    cutoff = 0.5 if len(name) == 2 else MIN_SIMILARITY
    matches = get_close_matches(name.lower(), names, n=1, cutoff=cutoff)
    return f" (did you mean {names[matches[0]]!r}?)" if matches else ""
