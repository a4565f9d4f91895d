"""Measured tables as snippets that pages include: ``generated/tables/<name>.md``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from reports.site.markdown import provenance, table
from reports.site.measured import DATA, read


def pages() -> dict[str, str]:
    """One snippet for each JSON of columns and rows below ``docs/generated/data``."""
    found = {file.stem: read(file.stem) for file in sorted(DATA.glob("*.json"))}
    return {
        f"tables/{name}.md": snippet(content)
        for name, content in found.items()
        if "columns" in content and "rows" in content
    }


def snippet(content: Mapping[str, Any]) -> str:
    """A table, the sentence below it, and where it comes from."""
    note = f"{content['note']}\n\n" if content.get("note") else ""
    return f"{table(content['columns'], content['rows'])}\n{note}{provenance(content)}"
