"""The glossary of CONTRIBUTING.md lists exactly the public names that contain one of its words."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("dynamics", "ocp", "problems", "reports")


def glossary() -> dict[str, set[str]]:
    """Return a mapping from each word of the glossary to the public names that its table lists."""
    table = (ROOT / "CONTRIBUTING.md").read_text().partition("## Words")[2]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]
    return {row[0]: set(re.findall(r"`([\w.]+)`", row[2])) for row in rows if len(row) == 3}


WORDS = {word: names for word, names in glossary().items() if word.isalpha() and word != "word"}


def words_of(name: str) -> set[str]:
    """Return the words of a name: multiple and shooting for ``MultipleShooting`` and ``multiple_shooting``."""
    return {part.lower() for part in re.findall(r"[A-Z]?[a-z0-9]+|[A-Z]+(?![a-z])", name)}


@cache
def public_names() -> frozenset[str]:
    """Return the names of all public classes, and the dotted names of all modules."""
    found: set[str] = set()
    for file in (file for package in PACKAGES for file in (ROOT / package).rglob("*.py")):
        room = file.parent if file.stem == "__init__" else file.with_suffix("")
        found.add(".".join(room.relative_to(ROOT).parts))
        nodes = ast.walk(ast.parse(file.read_text()))
        found |= {n.name for n in nodes if isinstance(n, ast.ClassDef) and n.name[0] != "_"}
    return frozenset(found)


def bearers(word: str) -> set[str]:
    """Return the public names that contain a word, in the singular or the plural."""
    forms = {word, f"{word}s", f"{word.removesuffix('y')}ies"}
    return {name for name in public_names() if forms & words_of(name.rpartition(".")[2])}


@pytest.mark.parametrize("word", WORDS)
def test_a_word_has_one_meaning(word: str) -> None:
    assert bearers(word) == WORDS[word], "say in the glossary what it means, or choose another word"


def test_the_words_that_meant_several_things_are_told() -> None:
    assert {"path", "plan", "point", "machine", "reference", "study", "request"} <= set(WORDS)
