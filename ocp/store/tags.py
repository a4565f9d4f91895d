"""Words that a run is marked with."""

from __future__ import annotations

import re
from collections.abc import Iterable

from ocp.errors import InputError


def check_tags(tags: Iterable[str]) -> list[str]:
    """Return ``tags`` in order, each once.

    Raises :class:`~ocp.errors.InputError` for what is no word of letters, digits, ``_ . -``.
    """
    for tag in tags:
        if not re.fullmatch(r"[\w.-]{1,60}", tag):
            raise InputError(
                f"a tag is one word of letters, digits, _ . - and at most 60 of them, got {tag!r}"
            )
    return sorted(set(tags))
