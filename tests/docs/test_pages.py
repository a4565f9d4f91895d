"""Every command and program in README and docs works as printed and gives the printed output."""

from __future__ import annotations

import re
from contextlib import nullcontext
from pathlib import Path

import pytest

from tests.docs.pages import ROOT, Block, Walk, agrees, blocks, commands, pages

EXEMPT_AT_MOST = 6
QUICK = [
    "README.md",
    "docs/tutorials/first-solve.md",
    "docs/reference/problem-file.md",
    "docs/reference/python/index.md",
    "docs/theory/verdicts.md",
]
"""Pages that `make test` runs; `make test-slow` runs all others, slow blocks included."""


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def runnable(page: Path) -> list[Block]:
    return [block for block in blocks(page.read_text(encoding="utf-8")) if block.runs]


def slow_pages() -> list[Path]:
    """Return the pages with blocks that the quick tests do not run."""
    return [
        page
        for page in pages()
        if (found := runnable(page)) and (name(page) not in QUICK or any(b.slow for b in found))
    ]


@pytest.mark.costly_cases("docs/reference/problem-file.md", "docs/theory/verdicts.md")
@pytest.mark.parametrize("page", QUICK)
def test_a_page_works_as_printed(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert runnable(ROOT / page)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    Walk(ROOT / page, tmp_path).through(slow=False)


@pytest.mark.slow
@pytest.mark.parametrize("page", slow_pages(), ids=name)
def test_a_page_works_to_its_end(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    Walk(page, tmp_path).through(slow=True)


SOUGHT = (
    "MPC",
    "receding horizon",
    "URDF",
    "MJCF",
    "3-D",
    "mesh",
    "Jupyter",
    "my robot",
    "biped",
    "torque limits",
    "free final time",
)


@pytest.mark.parametrize("word", SOUGHT)
def test_a_word_that_people_look_for_is_a_heading(word: str) -> None:
    text = (ROOT / "docs/reference/cannot.md").read_text(encoding="utf-8")
    assert re.search(rf"^## .*\b{word}\b", text, re.MULTILINE | re.IGNORECASE)


def test_every_program_that_people_come_from_has_its_version_of_the_problem() -> None:
    """The versions of this package and of CasADi run; the others say that they were not run."""
    text = (ROOT / "docs/howto/coming-from.md").read_text(encoding="utf-8")
    for title in ("Ours", "CasADi Opti", "rockit", "do-mpc", "nosnoc", "Drake"):
        section = text.partition(f"\n## {title}\n")[2].partition("\n## ")[0]
        (block, *_) = (b for b in blocks(section) if b.language in ("console", "python"))
        assert block.runs == (title in ("Ours", "CasADi Opti")), title
        assert title == "Ours" or f"*{title.split()[-1]} beyond ours*" in section


def test_few_blocks_are_never_run() -> None:
    every = [b for page in pages() for b in blocks(page.read_text(encoding="utf-8"))]
    exempt = [b for b in every if b.mark.startswith("not run")]
    assert len(exempt) <= EXEMPT_AT_MOST
    assert all(len(b.mark.removeprefix("not run:").strip()) > 8 for b in exempt), "say why"


def test_blocks_are_found_with_their_marks_and_files() -> None:
    text = (
        '# t\n\n```python title="a.py"\nx = 1\n```\n\n<!-- slow -->\n```console\n$ a\nb\n```\n\n'
        "<!-- not run: needs a cluster -->\n\n```python\n1 / 0\n```\n    ```text\n    z\n    ```\n"
    )
    found = blocks(text)
    assert [(b.language, b.file, b.slow, b.runs) for b in found] == [
        ("python", "a.py", False, True),
        ("console", "", True, True),
        ("python", "", False, False),
        ("text", "", False, False),
    ]
    assert [b.text for b in found] == ["x = 1", "$ a\nb", "1 / 0", "z"]
    assert found[0].line == 3


def test_commands_are_parted_from_what_they_print() -> None:
    found = commands("$ a b\nout\n\nmore\n$ c \\\n    d\n$ e")
    assert [(c.line, c.output) for c in found] == [
        ("a b", "out\n\nmore"),
        ("c \\\n    d", ""),
        ("e", ""),
    ]


@pytest.mark.parametrize(
    ("printed", "shown", "same"),
    [
        ("cost 0.100609, ok\n", "cost 0.100609, ok", True),
        ("cost 0.100610, ok", "cost 0.100609, ok", True),
        ("cost 0.110609, ok", "cost 0.100609, ok", False),
        ("cost -0.100609", "cost 0.100609", False),
        ("run: runs/a/2026", "run: ...", True),
        ("a\nb\nc\nd", "a\n...\nd", True),
        ("a\nb\nc", "a\n...\nd", False),
        ("a\nb", "a", False),
        ("a", "a\nb", False),
        ("3 folds", "4 folds", False),
        ("mu   1e-8  x", "mu    1e-08  x", True),
        ("push-1d", "push-2d", False),
        (
            "  lam·gap  iter\n  3.3e-18    74  solved",
            "  lam·gap  iter\n  0.0e+00    73  solved",
            True,
        ),
        (
            "  lam·gap  iter\n  0.0e+00   117  solved",
            "  lam·gap  iter\n  0.0e+00    73  solved",
            False,
        ),
        (
            "  lam·gap  iter\n  3.3e-08    73  solved",
            "  lam·gap  iter\n  0.0e+00    73  solved",
            False,
        ),
        ("  pairs  iter\n     74    73  solved", "  pairs  iter\n     73    73  solved", False),
        ('"iterations": 20,', '"iterations": 18,', True),
        ('"iterations": 38,', '"iterations": 18,', False),
        ('"pairs": 20,', '"pairs": 18,', False),
    ],
)
def test_output_agrees_in_words_and_nearly_in_numbers(printed: str, shown: str, same: bool) -> None:
    assert agrees(printed, shown) is same


def test_a_wrong_page_is_told_with_its_place(tmp_path: Path) -> None:
    page = ROOT / "README.md"
    good, bad = (f"```console\n$ echo 1.5\n{text}\n```\n" for text in ("1.5", "1.6"))
    walk = Walk(page, tmp_path)
    walk.do(blocks(good)[0])
    with pytest.raises(AssertionError, match=r"README.md:1: \$ echo"):
        walk.do(blocks(bad)[0])
    with pytest.raises(AssertionError, match=r"README.md:1"):
        walk.do(blocks("```console\n$ false\n```\n")[0])
    fails = "<!-- fails -->\n```console\n$ {}\nno\n```\n"
    walk.do(blocks(fails.format("echo no >&2; false"))[0])
    with pytest.raises(AssertionError):
        walk.do(blocks(fails.format("echo no >&2"))[0])


def test_what_python_prints_is_held_to_the_text_behind_it(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    for shown, right in (("2", True), ("3", False)):
        page.write_text(f"```python\nprint(1 + 1)\n```\n\n```text\n{shown}\n```\n")
        with nullcontext() if right else pytest.raises(AssertionError, match="2"):
            Walk(page, tmp_path).through(slow=False)
