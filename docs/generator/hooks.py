"""Hooks of mkdocs, which expand folders of the navigation, and insert notebooks and equations."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from docs.generator import equations, notebooks

_LINK = re.compile(r"\]\(([\w/.-]+\.md)")
"""Pattern of a link to a page in a list of pages."""


def expanded(nav: Any, docs: Path) -> Any:
    """Return a navigation in which every entry ``folder/`` is replaced by the pages of that folder.

    ``index.md`` comes first, then pages in the order in which it links to them, then others by name.
    An entry whose folder has no page is removed.
    """
    if isinstance(nav, dict):
        inner = {title: expanded(entry, docs) for title, entry in nav.items()}
        return {title: entry for title, entry in inner.items() if entry}
    if isinstance(nav, str):
        return _pages(docs, nav) if nav.endswith("/") else nav
    spliced = []
    for entry in nav:
        pages_of_entry = expanded(entry, docs)
        spliced += pages_of_entry if isinstance(pages_of_entry, list) else [pages_of_entry]
    return [entry for entry in spliced if entry]


def _pages(docs: Path, folder: str) -> list[str]:
    files = [file.relative_to(docs / folder).as_posix() for file in (docs / folder).rglob("*.md")]
    index = docs / folder / "index.md"
    listed = _LINK.findall(index.read_text(encoding="utf-8")) if "index.md" in files else []
    place = {name: k for k, name in reversed(list(enumerate(["index.md", *listed])))}
    last = len(place) + len(listed)
    order = sorted(files, key=lambda name: (place.get(name, last), name.count("/"), name))
    return [folder + name for name in order]


def on_config(config: Any) -> Any:
    """Expand the folders in the navigation of ``config``, and return it."""
    config.nav = expanded(config.nav, Path(config.docs_dir))
    return config


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Return a page in which markers are replaced by notebooks with outputs, and by equations in MathML."""
    return equations.typeset(notebooks.shown(markdown), page.file.src_uri)
