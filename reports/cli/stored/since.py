"""From ``--since`` to a moment."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta

from ocp.errors import InputError

_SECONDS = {"s": 1, "m": 60, "h": 3600, "d": 86400, "w": 7 * 86400}


def moment(text: str) -> datetime:
    """Read ``2h`` (ago), or a date or time in ISO form, which is UTC where it says no zone.

    Raises :class:`~ocp.errors.InputError` for anything else.
    """
    if match := re.fullmatch(r"(\d{1,6})([smhdw])", text, re.ASCII):
        return datetime.now(UTC) - timedelta(seconds=int(match[1]) * _SECONDS[match[2]])
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        raise InputError(
            f"--since must be a date such as 2026-01-31, or a time ago such as 30m, 2h, 7d, got"
            f" {text!r}"
        ) from None
    return found if found.tzinfo else found.replace(tzinfo=UTC)
