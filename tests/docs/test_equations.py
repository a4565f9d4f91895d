"""Equations of the site are set completely, have a description, and are cited by existing numbers."""

from __future__ import annotations

import re
from xml.etree import ElementTree as Xml

import pytest

from docs.generator import equations
from problems import names, spec
from reports.drawing.notation import plain
from tests.docs.pages import ROOT, pages


def formulas(line: str) -> list[Xml.Element]:
    """Return the elements that a line is set from, words included."""
    return list(Xml.fromstring(f"<line>{line.replace('<wbr>', '')}</line>"))


@pytest.mark.parametrize("name", names())
def test_every_equation_is_set_whole(name: str) -> None:
    """All letters and words of the source are in the formulas, in the same number."""
    lines = spec(name).equations
    for line, written in zip(lines, equations.mathml(lines), strict=True):
        parts = formulas(written)
        text = "".join("".join(part.itertext()) for part in parts)
        for word in re.findall(r'"([^"]*)"', line):
            assert "".join(word.split()) in "".join(text.split()), word
        assert {part.tag for part in parts} <= {"math", "span"}
        unquoted = re.sub('"[^"]*"', "", line)
        for sign, spelled in (("⟂", "perp"), ("∑", "sum"), ("𝜆", "lambda"), ("≥", ">=")):
            assert text.count(sign) == unquoted.count(spelled), (sign, line)


def test_a_formula_may_break_before_signs_and_relations_only() -> None:
    (line,) = equations.mathml(("a + (b + c) = -d, quad e / (f + g) <= 1",))
    first = [next(iter(part)) for part in formulas(line) if part.tag == "math"]
    assert [one.text for one in first] == ["𝑎", "+", "=", None, "≤"]
    assert first[3].tag == "mfrac"
    assert [one.get("form") for one in first] == [None, "infix", "infix", None, "infix"]


def test_a_block_becomes_formulas_with_words_and_numbers() -> None:
    page = equations.typeset(f"Before.\n\n{equations.listed('push-disc')}\nAfter.", "a/b.md")
    assert page.startswith("Before.") and page.endswith("After.") and "```" not in page
    said = re.findall('id="([^"]+)"><div role="math" aria-label="([^"]+)"', page)
    lines = spec("push-disc").equations
    assert [number for number, _ in said] == [f"push-disc.{k + 1}" for k in range(len(lines))]
    assert said[0][1] == plain(lines[0])
    by_hand = equations.typeset("<!-- equations:\na = b\n-->\n\n```text\na = b\n```\n", "index.md")
    assert "(a = b.1)" not in by_hand and by_hand.count('aria-label="a = b"') == 1


def test_a_citation_leads_to_its_equation() -> None:
    text = "See (push-disc.2), (fig.1) and (wall-1d.1)."
    assert equations.typeset(text, "theory/laws.md") == (
        "See [(push-disc.2)](../generated/gallery/push-disc.md#push-disc.2), (fig.1) and"
        " [(wall-1d.1)](../generated/gallery/wall-1d.md#wall-1d.1)."
    )
    assert "](push-disc.md#push-disc.2)" in equations.typeset(text, "generated/gallery/x.md")


def test_what_stands_in_for_equations_is_the_same_in_plain_characters() -> None:
    written = {page: equations.BLOCK.findall(page.read_text()) for page in pages()}
    assert sum(map(len, written.values())) > 5
    for page, found in written.items():
        for lines, stands_in in found:
            own = spec(lines).equations if lines in names() else lines.splitlines()
            assert [plain(line) for line in own] == stands_in.splitlines(), page.name


def test_cited_equations_exist() -> None:
    files = [*(ROOT / "problems").rglob("*.py"), *(ROOT / "docs").rglob("*.md")]
    cited = {found for file in files for found in equations.CITED.findall(file.read_text())}
    known = {(n, str(k + 1)) for n in names() for k in range(len(spec(n).equations))}
    assert {one for one in cited if one[0] in names()} <= known


@pytest.mark.parametrize("name", names())
def test_what_builds_a_problem_says_by_which_equations(name: str) -> None:
    cited = equations.CITED.findall(spec(name).build.__doc__ or "")
    assert cited and {one for one, _ in cited} == {name}
