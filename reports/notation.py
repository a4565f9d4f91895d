"""Equations in plain characters, and citations, both from the typst that they are written in."""

from __future__ import annotations

import html
import re
from functools import cache
from pathlib import Path

import typst

_TOKEN = re.compile(
    r'"(?P<text>[^"]*)"'
    r"|(?P<sum>sum_\((?P<index>\w+)=[^)]*\)\^\([^)]*\))"
    r"|(?P<word>[A-Za-z]+(?:\.[a-z]+)*)"
    r"|(?P<fraction> */ *| *\\/ *)"
    r"|(?P<other>.)"
)
_WORDS = {"lambda": "lam", "perp": "⟂", "quad": "", "min": "minimise ", "max": "maximise ",
          "tilde": "~", "infinity": "∞", "dots": "...", "plus.minus": "±", "top": "'", "dot": "·",
          "delta": "d", "dif": "d"}  # fmt: skip
_AROUND = {"norm": "||", "abs": "||", "dot": " '", "macron": "  "}
"""What stands before and behind a function's argument instead of its name and brackets."""


def plain(line: str) -> str:
    """Write ``line`` of typst's mathematics as a terminal shows it: ``abs(x)^2`` as ``|x|²``."""
    found, open_ = [], []
    after = ""
    for match in _TOKEN.finditer(line):
        token = match.group()
        if match["text"] is not None:
            token = match["text"]
        elif match["sum"]:
            token = f"sum_{match['index']}"
        elif match["word"] and line[match.end() : match.end() + 1] == "(" and token in _AROUND:
            after, token = _AROUND[token], ""
        elif match["word"]:
            token = _WORDS.get(token, token)
        elif match["fraction"]:
            token = "/"
        elif token == "(":
            open_.append(after or "()")
            token, after = open_[-1][0].strip(), ""
        elif token == ")" and open_:
            token = open_.pop()[1].strip()
        found.append(token)
    return _tidy("".join(found))


def _tidy(text: str) -> str:
    """Powers as superscripts, derivatives as ``dF/dx``, a difference as one word."""
    for sign, written in (("^2", "²"), ("^4", "⁴"), ("^+", "+"), ("^-", "-"), ("^±", "±"),
                          ("^'", "'"), ("_+", "+"), ("_-", "-"), ("_±", "±")):  # fmt: skip
        text = text.replace(sign, written)
    text = re.sub(r"\(d (\w+)\)", r"d\1", text)
    return re.sub(r"\bd (?=[a-z]_|q\b)", "d", text).strip()


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
