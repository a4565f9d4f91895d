"""What mkdocs calls while it builds: folders of the navigation become their pages."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def expanded(nav: Any, docs: Path) -> Any:
    """Replace every entry ``folder/`` of a navigation by the pages of that folder.

    ``index.md`` comes first, the others by name, those of folders inside last; an entry whose
    folder has no page goes. Other entries stay as they are.
    """
    if isinstance(nav, str):
        return _pages(docs, nav) if nav.endswith("/") else nav
    if isinstance(nav, dict):
        inner = {title: expanded(entry, docs) for title, entry in nav.items()}
        return {title: entry for title, entry in inner.items() if entry}
    return [entry for entry in (expanded(entry, docs) for entry in nav) if entry]


def _pages(docs: Path, folder: str) -> list[str]:
    files = (docs / folder).rglob("*.md")
    order = sorted(files, key=lambda file: (len(file.parts), file.stem != "index", file.name))
    return [file.relative_to(docs).as_posix() for file in order]


def on_config(config: Any) -> Any:
    """Give mkdocs the navigation with its folders expanded."""
    config.nav = expanded(config.nav, Path(config.docs_dir))
    return config
