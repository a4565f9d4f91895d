"""Tables of measured numbers, as JSON under ``docs/generated/data``, each with where it came from.

What measures calls :func:`write_table`; the site shows the table by a line that includes
``generated/tables/<name>.md``, which :mod:`reports.site` writes from the JSON.
"""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

from ocp.errors import InputError
from ocp.store.atomic import write
from ocp.store.provenance import git_revision, versions

DOCS = Path(__file__).resolve().parents[2] / "docs"
GENERATED = DOCS / "generated"
DATA = GENERATED / "data"

Cell = str | int | float | bool | None


def origin(command: str) -> dict[str, str]:
    """Where numbers come from: command, commit, date (UTC) and the computer."""
    return {
        "command": command,
        "commit": (git_revision() or "unknown")[:10],
        "date": datetime.now(UTC).date().isoformat(),
        "machine": computer(),
    }


@cache
def computer() -> str:
    """Processor, number of cores, and versions of Python and CasADi."""
    model = platform.processor() or platform.machine()
    file = Path("/proc/cpuinfo")
    if file.exists():
        lines = (line.partition(":") for line in file.read_text().splitlines())
        models = [value.strip() for name, _, value in lines if name.strip() == "model name"]
        model = models[0] if models else model
    known = versions()
    python, casadi = known["python"], known["casadi"]
    return f"{model}, {os.cpu_count()} cores, Python {python}, CasADi {casadi}"


def write_table(
    name: str,
    *,
    title: str,
    command: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[Cell]],
    note: str = "",
) -> Path:
    """Store a table as ``<name>.json``: ``rows`` of cells under ``columns``, texts as they are.

    ``command`` is what measured it, ``note`` a sentence to stand below it. Returns the file.
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
    """Store ``content`` as ``<name>.json``, a line a row of what is in it."""
    file = DATA / f"{name}.json"
    write(file, _lines(content).encode())
    return file


def _lines(content: Mapping[str, Any]) -> str:
    """Write JSON in which each item of a list stands on a line of its own."""
    parts = []
    for key, value in content.items():
        text = json.dumps(value, ensure_ascii=False)
        if isinstance(value, list) and value and isinstance(value[0], list | dict):
            items = (f"  {json.dumps(item, ensure_ascii=False)}" for item in value)
            text = "[\n" + ",\n".join(items) + "\n]"
        parts.append(f"{json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(parts) + "\n}\n"


def read(name: str) -> dict[str, Any]:
    """Return what ``<name>.json`` holds."""
    return json.loads((DATA / f"{name}.json").read_text(encoding="utf-8"))
