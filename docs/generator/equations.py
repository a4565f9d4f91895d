"""Equations of pages in MathML, which typst makes from the same lines as in reports.

A page marks equations by ``<!-- equations: push-disc -->``, or by lines of typst in such a comment,
before a block of plain text, which the site replaces. ``(push-disc.2)`` becomes a link.
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
"""Pattern of the marker of equations, followed by their plain text, which is shown where a page is not rendered."""
CITED = re.compile(r"\(([a-z][a-z0-9-]*)\.(\d+)\)")
"""Pattern of the citation of a numbered equation, such as ``(push-disc.2)``."""
_TEMPLATE = Path(__file__).with_name("equations.typ")
"""Template with which typst sets lines of mathematics."""
_BREAKS = {"=", "≤", "≥", "⟂", "+", "−", "∈"}
"""Signs before which a line may break outside brackets."""
_BEFORE_COMMA = re.compile(r"</span> <wbr>(<math[^>]*><mo[^>]*>[,;])")
"""Pattern of a possible line break before a comma, which is removed."""


def listed(name: str) -> str:
    """Return the marker and the plain text of the numbered equations of a problem."""
    lines = [f"{plain(line)}    ({k})" for k, line in enumerate(spec(name).equations, 1)]
    return "\n".join([f"<!-- equations: {name} -->\n", "```text", *lines, "```\n"])


def typeset(page: str, url: str) -> str:
    """Return the page at ``url`` with its equations in MathML, and citations of equations as links."""
    page = CITED.sub(lambda match: _link(match, posixpath.dirname(url)), page)
    return BLOCK.sub(lambda match: _equations(match[1]), page)


def _link(match: re.Match[str], folder: str) -> str:
    text, name = match[0], match[1]
    place = posixpath.relpath(f"generated/gallery/{name}.md#{text[1:-1]}", folder or ".")
    return f"[{text}]({place})" if name in names() else text


def _equations(content: str) -> str:
    is_problem = content in names()
    lines = spec(content).equations if is_problem else tuple(content.splitlines())
    blocks = ""
    for k, (line, pieces) in enumerate(zip(lines, mathml(lines), strict=True), 1):
        number, spoken = f"{content}.{k}", html.escape(plain(line))
        place, number_text = (f' id="{number}"', f"<span>({number})</span>") if is_problem else ("", "")
        blocks += f'<div class="equation"{place}><div role="math" aria-label="{spoken}">{pieces}</div>'
        blocks += f"{number_text}</div>"
    return f'<div class="equations">{blocks}</div>\n'


@cache
def mathml(lines: Sequence[str]) -> list[str]:
    """Return each line of typst's mathematics in HTML, as formulas between which a browser may break the line."""
    page, _ = typst.compile_with_warnings(
        str(_TEMPLATE),
        root=str(_TEMPLATE.parents[2]),
        format="html",
        ignore_system_fonts=True,
        sys_inputs={"lines": json.dumps(lines)},
    )
    formulas = re.findall(r"<math.*?</math>", page.decode(), re.S)
    lines_of = ("<wbr>".join(_pieces(Xml.fromstring(formula))) for formula in formulas)
    return [_BEFORE_COMMA.sub(r"</span>\1", line) for line in lines_of]


def _pieces(formula: Xml.Element) -> Iterator[str]:
    """Yield the pieces of a formula in HTML: formulas that begin with a relation or a sign, and words."""
    piece = ""
    for element in formula:
        word, wide = element.tag == "mtext", element.get("width") == "1em"
        sign = element.tag == "mo" and element.text in _BREAKS and element.get("form") != "prefix"
        if piece and (word or wide or sign):
            yield f'<math displaystyle="true">{piece}</math>'
            piece = ""
        if sign:
            element.set("form", "infix")
        if word:
            yield f" <span>{html.escape(element.text or '')}</span> "
        elif wide:
            yield '<span class="quad"></span>'
        elif piece or element.tag != "mspace":
            piece += Xml.tostring(element, encoding="unicode")
    if piece:
        yield f'<math displaystyle="true">{piece}</math>'
