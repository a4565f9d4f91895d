"""The papers behind the problems, as typst sets them from ``references.bib``."""

from __future__ import annotations

import html
import re
from functools import cache
from pathlib import Path

import typst

_PAGE = """#cite(<{key}>, form: "full")
#bibliography("/references.bib", style: "springer-basic-author-date")"""


@cache
def full_citation(key: str) -> str:
    """Return an entry as its style writes it; a key that is not there stands for itself."""
    source, root = _PAGE.format(key=key).encode(), str(Path(__file__).parent)
    try:
        page = typst.compile(source, root=root, format="html", ignore_system_fonts=True)
    except typst.TypstError:
        return key
    cited = page.decode().partition("<p>")[2].partition("</p>")[0]
    words = html.unescape(re.sub(r"<[^>]*>", "", cited)).split()
    return " ".join(words).removesuffix(".")
