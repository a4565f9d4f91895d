"""The table of contacts of a solve, the same on the console and in the PDF."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.console import Group
from rich.text import Text

from ocp.judge.audit import Audit
from reports.console import number, table_of

_ACTIVE = "Active: normal impulse above 1e-6 and above the gap, in characteristic sizes."
_DISTANT = "Distant: such an impulse over a larger gap, force at a distance of smoothing."


def contact_table(audit: Audit) -> Group:
    """Active steps, peak force and sliding of each contact; the idle ones are counted."""
    heads, rows = contact_columns(audit)
    return Group(table_of(*heads, rows=rows), *map(Text, contact_notes(audit)))


def contact_columns(audit: Audit) -> tuple[list[str], list[list[str]]]:
    """Titles, ``>`` before those of numbers, and rows of the contacts that push.

    Columns of sliding stand with friction alone, that of distant steps where there are any.
    """
    rough, far = math.isfinite(audit.cone_violation), _far(audit)
    columns = {
        "contact": True,
        ">active": True,
        ">distant": far,
        ">slipping": rough,
        ">peak [N]": True,
        ">slid [m]": rough,
        ">degenerate": True,
        "at steps": True,
    }
    rows = [
        [
            found.name,
            str(found.steps),
            str(found.distant),
            str(found.slipping),
            number(found.peak_force, 4),
            number(found.slid, 3) if found.slipping else "0",
            str(found.degenerate),
            spans_text(found.spans),
        ]
        for found in audit.contacts
        if found.steps or found.distant
    ]
    kept = [[cell for cell, keep in zip(row, columns.values(), strict=True) if keep] for row in rows]
    return [head for head, keep in columns.items() if keep], kept


def contact_notes(audit: Audit) -> list[str]:
    """What active and distant mean, and how many contacts never push."""
    idle = [found for found in audit.contacts if not (found.steps or found.distant)]
    notes = [_ACTIVE, *([_DISTANT] if _far(audit) else [])]
    if idle:
        steps = sum(found.degenerate for found in idle)
        grazing = f", degenerate at {steps} steps" if steps else ""
        many = "contact" if len(idle) == 1 else "contacts"
        notes.append(f"{len(idle)} {many} never active{grazing}.")
    return notes


def _far(audit: Audit) -> bool:
    return any(found.distant for found in audit.contacts)


def spans_text(spans: Sequence[Sequence[int]], most: int = 6) -> str:
    """Spans of steps: ``0-4, 7, 9-12``; the first ``most`` and a count of the others."""
    parts = [f"{first}-{last}" if last > first else str(first) for first, last in spans]
    more = f", {len(parts) - most} more" if len(parts) > most else ""
    return ", ".join(parts[:most]) + more
