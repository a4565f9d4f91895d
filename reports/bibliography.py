"""The papers behind the problems, as typst sets them from ``references.bib``."""

from __future__ import annotations

import html
import re
from functools import cache
from pathlib import Path

import typst

_ROOT = Path(__file__).parent


@cache
def full_citation(key: str) -> str:
    """Return an entry as its style writes it; a key that is not there stands for itself."""
    page, given = str(_ROOT / "templates" / "citation.typ"), {"key": key}
    try:
        set_page = typst.compile(
            page, root=str(_ROOT), format="html", ignore_system_fonts=True, sys_inputs=given
        )
    except typst.TypstError:
        return key
    cited = set_page.decode().partition("<p>")[2].partition("</p>")[0]
    words = html.unescape(re.sub(r"<[^>]*>", "", cited)).split()
    return " ".join(words).removesuffix(".")
