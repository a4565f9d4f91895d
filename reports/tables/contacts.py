"""Table of the contacts of a solve, the same on the console and in the PDF."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.console import Group
from rich.text import Text

from ocp.judge.audit import Audit
from reports.tables.console import number, table_of

_ACTIVE_NOTE = "Active: normal impulse above 1e-6 and above the gap, in characteristic sizes."
"""Note that defines active contacts."""
_DISTANT_NOTE = "Distant: such an impulse over a larger gap, force at a distance of smoothing."
"""Note that defines distant contacts."""
MAX_SPANS = 6
"""Number of spans of steps that a table shows."""


def contact_table(audit: Audit) -> Group:
    """Return a table of active steps, peak force and sliding per contact, with notes below it."""
    heads, rows = contact_columns(audit)
    return Group(table_of(*heads, rows=rows), *map(Text, contact_notes(audit)))


def contact_columns(audit: Audit) -> tuple[list[str], list[list[str]]]:
    """Return column titles, with ``>`` before titles of numbers, and a row for each contact with a force.

    Columns on sliding appear only with friction, the column of distant steps only if there are such steps.
    """
    has_friction, has_distant = math.isfinite(audit.cone_violation), _far(audit)
    columns = {
        "contact": True,
        ">active": True,
        ">distant": has_distant,
        ">slipping": has_friction,
        ">peak [N]": True,
        ">slid [m]": has_friction,
        ">degenerate": True,
        "at steps": True,
    }
    rows = [
        [
            contact.name,
            str(contact.steps),
            str(contact.distant),
            str(contact.slipping),
            number(contact.peak_force, 4),
            number(contact.slid, 3) if contact.slipping else "0",
            str(contact.degenerate),
            spans_text(contact.spans),
        ]
        for contact in audit.contacts
        if contact.steps or contact.distant
    ]
    shown_rows = [[cell for cell, is_shown in zip(row, columns.values(), strict=True) if is_shown] for row in rows]
    return [head for head, is_shown in columns.items() if is_shown], shown_rows


def contact_notes(audit: Audit) -> list[str]:
    """Return sentences that define active and distant contacts, and count the contacts without a force."""
    idle = [contact for contact in audit.contacts if not (contact.steps or contact.distant)]
    notes = [_ACTIVE_NOTE, *([_DISTANT_NOTE] if _far(audit) else [])]
    if idle:
        steps = sum(contact.degenerate for contact in idle)
        grazing = f", degenerate at {steps} steps" if steps else ""
        noun = "contact" if len(idle) == 1 else "contacts"
        notes.append(f"{len(idle)} {noun} never active{grazing}.")
    return notes


def _far(audit: Audit) -> bool:
    return any(contact.distant for contact in audit.contacts)


def spans_text(spans: Sequence[Sequence[int]]) -> str:
    """Return spans of steps as text, such as ``0-4, 7, 9-12``; after :data:`MAX_SPANS` a count of the others."""
    span_texts = [f"{first}-{last}" if last > first else str(first) for first, last in spans]
    remainder = f", {len(span_texts) - MAX_SPANS} more" if len(span_texts) > MAX_SPANS else ""
    return ", ".join(span_texts[:MAX_SPANS]) + remainder
