"""The store's runs on the terminal: two lines each, of which none is cut."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from textwrap import wrap
from typing import Any

Row = Mapping[str, Any]


def lines(rows: Sequence[Row]) -> Iterator[str]:
    """Each run as its number, whole name, problem and verdict; below law, method, N, scenarios."""
    wide = max(len(row["at"]) for row in rows)
    for row in rows:
        name = row["run"].rpartition("/")[2]
        yield f"{row['at']:>{wide}}  {name}  {row['problem']}  {outcome(row)}"
        told = row["damage"] or ", ".join(_parts(row))
        margin = " " * (wide + 2)
        yield from wrap(
            told, 80, initial_indent=margin, subsequent_indent=margin, break_on_hyphens=False
        )


def outcome(row: Row) -> str:
    """What came of a run, in a word or two."""
    from reports.console import number

    if row["damage"]:
        return "damaged"
    if row["return"] is not None:
        return f"return {number(row['return'], 4)}"
    word = row["grade"] if row["grade"] not in (None, "failed") else row["status"]
    cost = "" if row["cost"] is None else f"  cost {number(row['cost'])}"
    return f"{word}{cost}"


def law(row: Row) -> str:
    """A law with its knobs: ``barrier mu=0.001``."""
    knobs = row["contact_settings"] or {}
    said = (f"{name}={_word(value)}" for name, value in knobs.items() if value is not None)
    return " ".join([row["contact"], *said])


def _parts(row: Row) -> Iterator[str]:
    if row["kind"] != "solve":
        over = f" over {row['over']}" if row["over"] else ""
        yield f"{row['kind']}{over}"
    if row["algorithm"]:
        yield f"{row['algorithm']}, seed {row['seed']}"
    if row["contact"]:
        yield law(row)
    for key in ("method", "policy"):
        if row[key]:
            yield row[key]
    if row["N"] is not None:
        yield f"N={row['N']}"
        yield f"{row['scenarios']} scenario{'' if row['scenarios'] == 1 else 's'}"
    if row["tags"]:
        yield "tagged " + " ".join(row["tags"])


def _word(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def values(rows: Sequence[Row], key: str) -> list[str]:
    """What there is of ``key`` among the runs; with their status, their grade."""
    keys = ("status", "grade") if key == "status" else (key,)
    return sorted({str(row[one]) for row in rows for one in keys if row[one] is not None})
