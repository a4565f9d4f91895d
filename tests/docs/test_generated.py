"""``docs/generated`` is the output of ``make generated``, and every measured table is on a page."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from docs.generator import measured
from docs.generator.__main__ import pages as fresh
from docs.generator.measured import cell, table
from ocp.errors import InputError
from problems import describe, names, scenes, spec
from reports.drawing.notation import powers

LIMIT = 6_000_000
"""Maximum size of all pictures of the documentation together [bytes]."""


def test_generated_pages_are_in_step() -> None:
    """Pages of specs and helps agree with the code, those of measurements with their JSON."""
    wanted = fresh()
    there = {
        file.relative_to(measured.GENERATED).as_posix(): file.read_text(encoding="utf-8")
        for file in measured.GENERATED.rglob("*.md")
    }
    assert sorted(there) == sorted(wanted)
    stale = [name for name in wanted if there[name] != wanted[name]]
    assert not stale, "make generated writes them anew"


def test_every_measured_table_is_shown_on_a_page() -> None:
    """A measured table is included by a page, or is on the page of all others."""
    tables_of_data = {file.stem for file in measured.DATA.glob("*.json")} - measured.TABLES_BY_PROBLEM
    included = measured.included()
    assert included <= tables_of_data
    left = [measured.read(name) for name in tables_of_data - included]
    page = measured.table_pages().get("measured/index.md", "")
    assert sorted(re.findall("^## (.*)$", page, re.MULTILINE)) == sorted(t["title"] for t in left)


def test_a_table_that_no_page_includes_stands_on_the_page_of_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(measured, "DATA", tmp_path)
    for name in ("matrix", "fresh"):
        measured.write_table(name, title=name, command="make x", columns=("a",), rows=[["1"]])
    found = measured.table_pages()
    assert sorted(found) == ["measured/index.md", "tables/fresh.md", "tables/matrix.md"]
    assert "## fresh" in found["measured/index.md"] and "matrix" not in found["measured/index.md"]


def test_what_is_measured_says_how_where_and_when() -> None:
    for file in measured.DATA.rglob("*.json"):
        content = json.loads(file.read_text(encoding="utf-8"))
        assert all(content[key] for key in ("command", "commit", "date", "machine")), file.name
        widths = {len(row) for row in content.get("rows", [])}
        assert widths <= {len(content.get("columns", []))}, file.name


@pytest.mark.parametrize("name", names())
def test_a_problems_page_has_its_parameters_and_best_known_values(name: str) -> None:
    text = (measured.GENERATED / "gallery" / f"{name}.md").read_text(encoding="utf-8")
    for row in describe(spec(name)):
        assert f"| `{row['name']}` | {cell(row['value'])} | {powers(row['unit'])} |" in text
    for golden in spec(name).golden.values():
        assert f"{golden.cost:.9g}" in text


def test_a_table_is_kept_and_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measured, "DATA", tmp_path)
    rows = [["a", 1.5, None], ["b|c", 2, True]]
    given = {"title": "t", "command": "make x", "columns": ("n", "v", "w"), "note": "so"}
    measured.write_table("some", rows=rows, **given)
    kept = measured.read("some")
    assert kept["rows"] == rows and kept["command"] == "make x" and kept["note"] == "so"
    with pytest.raises(InputError, match="3 cells"):
        measured.write_table("some", rows=[["a"]], **given)
    assert table(kept["columns"], kept["rows"]).splitlines() == [
        "| n | v | w |",
        "| --- | ---: | --- |",
        "| a | 1.5 | – |",
        "| b\\|c | 2 | yes |",
    ]


def test_all_parts_of_a_problem_file_are_listed_with_their_arguments() -> None:
    text = (measured.GENERATED / "signatures" / "parts.md").read_text(encoding="utf-8")
    listed = {name.split(".")[0] for name in re.findall(r"^- `([\w.]+)\(", text, re.MULTILINE)}
    assert {*scenes.__all__, "Link", "Machine", "Sphere", "Part", "Constraint", "free"} <= listed
    (arguments,) = re.findall(r"^- `Problem\((.*)\)`", text, re.MULTILINE)
    for name in ("stage_cost", "terminal_cost", "u_lower", "x_upper", "path", "terminal", "guess"):
        assert f", {name}" in arguments
    assert ":class:" not in text and "``" not in text and "<factory>" not in text


def test_pictures_stay_small() -> None:
    pictures = measured.DOCS / "pictures"
    assert sum(file.stat().st_size for file in pictures.rglob("*") if file.is_file()) < LIMIT
