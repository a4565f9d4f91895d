"""The exception for wrong usage, and functions that format parts of its message."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

MAX_SHOWN_CHARACTERS = 80
"""Maximum length of a value's text in an error message."""
MIN_SIMILARITY = 0.6
"""Minimum similarity, from 0 to 1, for proposing a known name in place of an unknown one."""


class InputError(ValueError):
    """Error of usage; its message says what was wrong, what was expected and how to correct it."""

    exit_code = 2


def abbreviated(value: object) -> str:
    """Return ``repr(value)`` on one line of at most ``MAX_SHOWN_CHARACTERS``, or the type's name if repr raises."""
    try:
        text = repr(value)
    except Exception:
        return f"an unprintable {type(value).__name__}"
    text = " ".join(text.split())
    return text if len(text) <= MAX_SHOWN_CHARACTERS else f"{text[: MAX_SHOWN_CHARACTERS - 3]}..."


def did_you_mean(name: str, known_names: Iterable[str]) -> str:
    """Return ``" (did you mean 'x'?)"`` for the most similar known name, or ``""`` if none is similar."""
    names = {candidate.lower(): candidate for candidate in known_names}
    # In a name of two letters one letter may be wrong, such as mu for nu.
    cutoff = 0.5 if len(name) == 2 else MIN_SIMILARITY
    matches = get_close_matches(name.lower(), names, n=1, cutoff=cutoff)
    return f" (did you mean {names[matches[0]]!r}?)" if matches else ""
