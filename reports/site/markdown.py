"""Text and tables as Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any


def cell(value: Any) -> str:
    """Write a cell: numbers to six digits, nothing as a dash; a bar within would end it."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return text.replace("|", "\\|").replace("\n", " ")


def table(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Write a table; columns in which every cell begins like a number stand to the right."""
    body = [[cell(value) for value in row] for row in rows]
    right = [
        any(row[k] for row in body) and all(_is_number(row[k]) for row in body)
        for k in range(len(columns))
    ]
    rule = ["---:" if aligned else "---" for aligned in right]
    lines = [[cell(name) for name in columns], rule, *body]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _is_number(text: str) -> bool:
    return text in {"", "–"} or text.strip("*").lstrip("-+×").replace(".", "", 1)[:1].isdigit()


def provenance(origin: Mapping[str, Any]) -> str:
    """One small line with command, date, commit and computer."""
    return (
        f"<small>`{origin['command']}` · {origin['date']} · commit `{origin['commit']}` ·"
        f" {origin['machine']}</small>\n{{ .origin }}\n"
    )


def escaped(text: str) -> str:
    """Keep the signs of formulas from being read as Markdown or as HTML."""
    for sign in "\\`*_{}[]":
        text = text.replace(sign, f"\\{sign}")
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
