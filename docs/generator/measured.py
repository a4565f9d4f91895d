"""Measured tables and pictures of the site, each with its origin, and tables as Markdown."""

from __future__ import annotations

import json
import os
import platform
import re
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from PIL import Image

from ocp.errors import InputError
from ocp.store.atomic import write_file
from ocp.store.provenance import git_revision, versions


def cell(value: Any) -> str:
    """Return a table's cell in Markdown: numbers to six digits, None as a dash, bars escaped."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return text.replace("|", "\\|").replace("\n", " ")


def table(columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a table in Markdown; columns in which every cell begins like a number are aligned to the right."""
    body = [[cell(value) for value in row] for row in rows]
    right = [any(row[k] for row in body) and all(_is_number(row[k]) for row in body) for k in range(len(columns))]
    rule = ["---:" if aligned else "---" for aligned in right]
    lines = [[cell(name) for name in columns], rule, *body]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _is_number(text: str) -> bool:
    return text in {"", "–"} or text.strip("*").lstrip("-+×").replace(".", "", 1)[:1].isdigit()


def provenance(origin: Mapping[str, Any]) -> str:
    """Return a line in small print with the command, date, commit and computer of an :func:`origin`."""
    return (
        f"<small>`{origin['command']}` · {origin['date']} · commit `{origin['commit']}` ·"
        f" {origin['machine']}</small>\n{{ .origin }}\n"
    )


def escaped(text: str) -> str:
    """Return ``text`` with characters escaped that are special in Markdown or HTML."""
    for sign in "\\`*_{}[]":
        text = text.replace(sign, f"\\{sign}")
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


DOCS = Path(__file__).resolve().parents[2] / "docs"
"""Folder of the site."""
GENERATED = DOCS / "generated"
"""Folder of the generated pages."""
DATA = GENERATED / "data"
"""Folder of measured numbers."""

Cell = str | int | float | bool | None


def origin(command: str) -> dict[str, str]:
    """Return the origin of numbers measured now: command, commit, date (UTC) and computer."""
    return {
        "command": command,
        "commit": (git_revision() or "unknown")[:10],
        "date": datetime.now(UTC).date().isoformat(),
        "machine": computer(),
    }


@cache
def computer() -> str:
    """Return this computer's processor and number of cores, and the versions of Python and CasADi, as text."""
    model = platform.processor() or platform.machine()
    file = Path("/proc/cpuinfo")
    if file.exists():
        lines = (line.partition(":") for line in file.read_text().splitlines())
        models = [value.strip() for name, _, value in lines if name.strip() == "model name"]
        model = models[0] if models else model
    installed = versions()
    programs = f"Python {installed['python']}, CasADi {installed['casadi']}"
    return f"{model}, {os.cpu_count()} cores, {programs}"


def write_table(
    name: str, *, title: str, command: str, columns: Sequence[str], rows: Sequence[Sequence[Cell]], note: str = ""
) -> Path:
    """Store a table with ``columns`` and ``rows`` of cells as ``<name>.json``; return the file.

    ``command`` is the one that measured it, ``note`` a sentence below it.
    Raises :class:`~ocp.errors.InputError` for a row that is not as long as ``columns``.
    """
    for row in rows:
        if len(row) != len(columns):
            raise InputError(f"{name}: expected {len(columns)} cells in a row, got {list(row)}")
    return write_data(
        name,
        {
            "title": title,
            **origin(command),
            "columns": list(columns),
            "rows": [list(row) for row in rows],
            "note": note,
        },
    )


def write_data(name: str, content: Mapping[str, Any]) -> Path:
    """Store ``content`` as ``<name>.json``, with one line for each item of a list; return the file."""
    file = DATA / f"{name}.json"
    write_file(file, _lines(content).encode())
    return file


def _lines(content: Mapping[str, Any]) -> str:
    """Return ``content`` as JSON in which each item of a list is on a line of its own."""
    entries = []
    for key, value in content.items():
        text = json.dumps(value, ensure_ascii=False)
        if isinstance(value, list) and value and isinstance(value[0], list | dict):
            items = (f"  {json.dumps(item, ensure_ascii=False)}" for item in value)
            text = "[\n" + ",\n".join(items) + "\n]"
        entries.append(f"{json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(entries) + "\n}\n"


def read(name: str) -> dict[str, Any]:
    """Return the content of ``<name>.json`` in :data:`DATA`."""
    return json.loads((DATA / f"{name}.json").read_text(encoding="utf-8"))


COLOURS = 200
"""Maximum number of colours of a stored picture."""


def save_picture(figure: Figure, name: str) -> Path:
    """Write ``figure`` to ``docs/pictures/<name>.png``, reduced to few colours; return the file."""
    rendered, small = BytesIO(), BytesIO()
    figure.savefig(rendered, format="png", dpi=110, bbox_inches="tight", metadata={"Software": None})
    picture = (
        Image.open(rendered)
        .convert("RGB")
        .quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    )
    picture.save(small, format="png", optimize=True)
    file = DOCS / "pictures" / f"{name}.png"
    write_file(file, small.getvalue())
    return file


TABLES_BY_PROBLEM = {"verdicts", "refined"}
"""Tables whose rows are on the pages of the problems."""


def table_pages() -> dict[str, str]:
    """Return a snippet for each JSON table, and a page for the tables that no other page includes."""
    contents_by_name = {file.stem: read(file.stem) for file in sorted(DATA.glob("*.json"))}
    tables = {name: content for name, content in contents_by_name.items() if "columns" in content}
    snippets = {f"tables/{name}.md": snippet(content) for name, content in tables.items()}
    if unplaced := [name for name in tables if name not in included() | TABLES_BY_PROBLEM]:
        sections = [f"## {tables[name]['title']}\n\n{snippet(tables[name])}" for name in unplaced]
        snippets["measured/index.md"] = "\n".join(["# Other measurements\n", *sections])
    return snippets


def included() -> set[str]:
    """Return the names of the tables that handwritten pages include."""
    handwritten_pages = (page for page in DOCS.rglob("*.md") if not page.is_relative_to(GENERATED))
    inclusion = re.compile(r'--8<-- "generated/tables/([\w-]+)\.md"')
    return {name for page in handwritten_pages for name in inclusion.findall(page.read_text(encoding="utf-8"))}


def snippet(content: Mapping[str, Any]) -> str:
    """Return a stored table in Markdown, with its note and its origin."""
    note = f"{content['note']}\n\n" if content.get("note") else ""
    return f"{table(content['columns'], content['rows'])}\n{note}{provenance(content)}"
