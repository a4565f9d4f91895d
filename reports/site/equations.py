"""Equations of problems in MathML, set by typst from the lines that reports are set from.

A page says ``<!-- equations: push-disc -->``, or ``push-disc.2`` for one of them, before a block of
plain text, which stands in for them where pages are read as they are. ``(push-disc.2)`` is a link.
"""

from __future__ import annotations

import html
import json
import posixpath
import re
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from xml.etree import ElementTree as Xml

import typst

from problems import names, spec
from reports.notation import plain

_BLOCK = re.compile(r"<!-- equations: ([\w-]+?)(?:\.(\d+))? -->\n+```text\n.*?\n```\n", re.S)
CITED = re.compile(r"\(([a-z][a-z0-9-]*)\.(\d+)\)")
_ROOT = Path(__file__).parents[1]
_BREAKS = {"=", "≤", "≥", "⟂", "+", "−", "∈"}
"""Before these a line may break, where no bracket is open."""
_BEFORE_COMMA = re.compile(r"</span> <wbr>(<math[^>]*><mo[^>]*>[,;])")


def listed(name: str, only: int | None = None) -> str:
    """The marker and the plain text of the equations of ``name``, or of number ``only``."""
    lines = {k: plain(line) for k, line in enumerate(spec(name).equations, 1) if only in (None, k)}
    text = "\n".join(f"{line}    ({k})" for k, line in lines.items())
    return f"<!-- equations: {name}{f'.{only}' if only else ''} -->\n\n```text\n{text}\n```\n"


def typeset(page: str, url: str) -> str:
    """The page at ``url`` with its equations in MathML, and citations of equations as links."""
    page = CITED.sub(lambda found: _link(found, posixpath.dirname(url)), page)
    return _BLOCK.sub(lambda found: _equations(found[1], found[2]), page)


def _link(found: re.Match[str], folder: str) -> str:
    name = found[1]
    place = posixpath.relpath(f"generated/gallery/{name}.md", folder or ".")
    return f"[{found[0]}]({place}#{name}.{found[2]})" if name in names() else found[0]


def _equations(name: str, only: str | None) -> str:
    lines = spec(name).equations
    numbered = zip(range(1, len(lines) + 1), lines, mathml(lines), strict=True)
    shown = [_line(f"{name}.{k}", *parts) for k, *parts in numbered if only in (None, str(k))]
    return f'<div class="equations">{"".join(shown)}</div>\n'


def _line(number: str, line: str, pieces: str) -> str:
    said = html.escape(plain(line))
    return (
        f'<div class="equation" id="{number}"><div role="math" aria-label="{said}">{pieces}</div>'
        f"<span>({number})</span></div>"
    )


@cache
def mathml(lines: Sequence[str]) -> list[str]:
    """Each line of typst's mathematics as formulas between which a browser may break it."""
    given = {"lines": json.dumps(lines)}
    page, _ = typst.compile_with_warnings(
        str(_ROOT / "templates" / "equations.typ"), root=str(_ROOT), format="html",
        ignore_system_fonts=True, sys_inputs=given,
    )  # fmt: skip
    found = re.findall(r"<math.*?</math>", page.decode(), re.S)
    lines_of = ("<wbr>".join(_pieces(Xml.fromstring(formula))) for formula in found)
    return [_BEFORE_COMMA.sub(r"</span>\1", line) for line in lines_of]


def _pieces(formula: Xml.Element) -> Iterator[str]:
    """Formulas that begin with a relation or a sign, and words, which break like all words."""
    piece: list[Xml.Element] = []
    for part in formula:
        word, wide = part.tag == "mtext", part.get("width") == "1em"
        sign = part.tag == "mo" and part.text in _BREAKS and part.get("form") != "prefix"
        if piece and (word or wide or sign):
            yield _formula(piece)
            piece = []
        if word:
            yield f" <span>{html.escape(part.text or '')}</span> "
        elif wide:
            yield '<span class="quad"></span>'
        elif piece or part.tag != "mspace":
            piece.append(part)
    if piece:
        yield _formula(piece)


def _formula(piece: list[Xml.Element]) -> str:
    if piece[0].tag == "mo" and len(piece) > 1 and piece[0].get("form") != "prefix":
        piece[0].set("form", "infix")
    inner = "".join(Xml.tostring(part, encoding="unicode") for part in piece)
    return f'<math displaystyle="true">{inner}</math>'
