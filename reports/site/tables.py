"""Measured tables as snippets that pages include: ``generated/tables/<name>.md``.

Those that no page includes stand on a page of their own, so that nothing measured is out of sight.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from reports.site.markdown import provenance, table
from reports.site.measured import DATA, DOCS, GENERATED, read

APART = {"verdicts", "refined"}
"""Tables that are shown a problem at a time."""


def pages() -> dict[str, str]:
    """One snippet for each JSON of columns and rows, and the page of those shown nowhere else."""
    found = {file.stem: read(file.stem) for file in sorted(DATA.glob("*.json"))}
    tables = {name: content for name, content in found.items() if "columns" in content}
    written = {f"tables/{name}.md": snippet(content) for name, content in tables.items()}
    if left := [name for name in tables if name not in included() | APART]:
        written["measured/index.md"] = others({name: tables[name] for name in left})
    return written


def included() -> set[str]:
    """Names of the tables that pages written by hand include."""
    written = (page for page in DOCS.rglob("*.md") if not page.is_relative_to(GENERATED))
    return {name for page in written for name in _names(page.read_text(encoding="utf-8"))}


def _names(text: str) -> Iterable[str]:
    return re.findall(r'--8<-- "generated/tables/([\w-]+)\.md"', text)


def others(tables: Mapping[str, Mapping[str, Any]]) -> str:
    """The page of tables that stand on no other."""
    parts = [f"## {content['title']}\n\n{snippet(content)}" for content in tables.values()]
    return "\n".join(["# Other measurements\n", *parts])


def snippet(content: Mapping[str, Any]) -> str:
    """A table, the sentence below it, and where it comes from."""
    note = f"{content['note']}\n\n" if content.get("note") else ""
    return f"{table(content['columns'], content['rows'])}\n{note}{provenance(content)}"
