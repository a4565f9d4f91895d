"""Citations, typeset by typst from ``references.bib``."""

from __future__ import annotations

import html
import re
from functools import cache
from pathlib import Path

_ROOT = Path(__file__).parent
"""Folder that typst may read: templates and bibliography."""


@cache
def full_citation(key: str) -> str:
    """Return the full citation of a bibliography entry as text, or ``key`` itself if there is no such entry."""
    import typst

    page, inputs = str(_ROOT / "templates" / "citation.typ"), {"key": key}
    try:
        set_page = typst.compile(page, root=str(_ROOT), format="html", ignore_system_fonts=True, sys_inputs=inputs)
    except typst.TypstError:
        return key
    cited = set_page.decode().partition("<p>")[2].partition("</p>")[0]
    text_words = html.unescape(re.sub(r"<[^>]*>", "", cited)).split()
    return " ".join(text_words).removesuffix(".")
