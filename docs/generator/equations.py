"""Equations in MathML, set by typst from the lines that reports are set from.

Before a block of plain text, which stands in for them where pages are read as they are, a page says
``<!-- equations: push-disc -->``, or has lines of typst there. ``(push-disc.2)`` is a link.
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
from reports.drawing.notation import plain

BLOCK = re.compile(r"<!-- equations:\s+(.*?)\s+-->\n+```text\n(.*?)\n```\n", re.S)
CITED = re.compile(r"\(([a-z][a-z0-9-]*)\.(\d+)\)")
_TEMPLATE = Path(__file__).with_name("equations.typ")
_BREAKS = {"=", "≤", "≥", "⟂", "+", "−", "∈"}
"""Before these a line may break, where no bracket is open."""
_BEFORE_COMMA = re.compile(r"</span> <wbr>(<math[^>]*><mo[^>]*>[,;])")


def listed(name: str) -> str:
    """The marker and the plain text of the numbered equations of a problem."""
    lines = [f"{plain(line)}    ({k})" for k, line in enumerate(spec(name).equations, 1)]
    return "\n".join([f"<!-- equations: {name} -->\n", "```text", *lines, "```\n"])


def typeset(page: str, url: str) -> str:
    """The page at ``url`` with its equations in MathML, and citations of equations as links."""
    page = CITED.sub(lambda found: _link(found, posixpath.dirname(url)), page)
    return BLOCK.sub(lambda found: _equations(found[1]), page)


def _link(found: re.Match[str], folder: str) -> str:
    text, name = found[0], found[1]
    place = posixpath.relpath(f"generated/gallery/{name}.md#{text[1:-1]}", folder or ".")
    return f"[{text}]({place})" if name in names() else text


def _equations(given: str) -> str:
    named = given in names()
    lines = spec(given).equations if named else tuple(given.splitlines())
    shown = ""
    for k, (line, pieces) in enumerate(zip(lines, mathml(lines), strict=True), 1):
        number, said = f"{given}.{k}", html.escape(plain(line))
        place, told = (f' id="{number}"', f"<span>({number})</span>") if named else ("", "")
        shown += f'<div class="equation"{place}><div role="math" aria-label="{said}">{pieces}</div>'
        shown += f"{told}</div>"
    return f'<div class="equations">{shown}</div>\n'


@cache
def mathml(lines: Sequence[str]) -> list[str]:
    """Each line of typst's mathematics as formulas between which a browser may break it."""
    page, _ = typst.compile_with_warnings(
        str(_TEMPLATE),
        root=str(_TEMPLATE.parents[2]),
        format="html",
        ignore_system_fonts=True,
        sys_inputs={"lines": json.dumps(lines)},
    )
    found = re.findall(r"<math.*?</math>", page.decode(), re.S)
    lines_of = ("<wbr>".join(_pieces(Xml.fromstring(formula))) for formula in found)
    return [_BEFORE_COMMA.sub(r"</span>\1", line) for line in lines_of]


def _pieces(formula: Xml.Element) -> Iterator[str]:
    """Formulas that begin with a relation or a sign, and words, which break like all words."""
    piece = ""
    for part in formula:
        word, wide = part.tag == "mtext", part.get("width") == "1em"
        sign = part.tag == "mo" and part.text in _BREAKS and part.get("form") != "prefix"
        if piece and (word or wide or sign):
            yield f'<math displaystyle="true">{piece}</math>'
            piece = ""
        if sign:
            part.set("form", "infix")
        if word:
            yield f" <span>{html.escape(part.text or '')}</span> "
        elif wide:
            yield '<span class="quad"></span>'
        elif piece or part.tag != "mspace":
            piece += Xml.tostring(part, encoding="unicode")
    if piece:
        yield f'<math displaystyle="true">{piece}</math>'
