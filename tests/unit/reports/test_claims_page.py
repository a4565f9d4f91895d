"""The README's tables of claims: how they are written, and that they say what the tests say."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from ocp.errors import InputError
from reports import smoothings
from reports.claims import BEGIN, END, rewritten, with_table
from tests.golden.figures.compared import compared
from tests.golden.figures.verdicts import VERDICTS

README = Path(__file__).parents[3] / "README.md"
FIGURES = [
    {"id": "X1", "claims": [
        {"claim": "|a| < 1", "source": "s", "expected": "e", "measured": "0.5", "holds": True},
        {"claim": "b", "source": "s", "expected": "e", "measured": "2", "holds": False},
    ]},
    {"id": "X2", "claims": [
        {"claim": "c", "source": "s", "expected": "e", "measured": "3", "holds": True},
    ]},
]  # fmt: skip


def test_the_block_is_replaced_and_nothing_else() -> None:
    page = rewritten(f"before\n{BEGIN}\nstale\n{END}\nafter\n", FIGURES)
    assert page.startswith(f"before\n{BEGIN}\nOf 3 claims 2 hold;")
    assert page.endswith(f"</details>\n{END}\nafter\n")
    assert "stale" not in page
    assert "<summary>X1: 1 of 2 hold</summary>" in page
    assert "| \\|a\\| < 1 | s | e | 0.5 | yes |" in page
    assert "| b | s | e | 2 | no |" in page
    assert rewritten(page, FIGURES) == page


@pytest.mark.parametrize("text", ["", BEGIN, f"{END} {BEGIN}", f"{BEGIN} {END} {BEGIN} {END}"])
def test_a_page_without_its_markers_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="once each"):
        rewritten(text, FIGURES)


def test_the_table_of_smoothings_is_read_from_its_file(tmp_path: Path) -> None:
    made = compared(lambda key: (1.0, 1.0 if "exact" in key else 1.05))
    file = tmp_path / "N3.nc"
    made.to_netcdf(file, engine="scipy", format="NETCDF3_64BIT")
    figures = [*FIGURES, {"id": "N3", "files": [str(tmp_path / "N3.pdf"), str(file)]}]
    text = f"before\n{smoothings.BEGIN}\nstale\n{smoothings.END}\nafter\n"
    page = with_table(text, figures)
    inside = smoothings.table(made)
    assert page == f"before\n{smoothings.BEGIN}\n{inside}{smoothings.END}\nafter\n"
    assert with_table(page, figures) == page
    assert with_table(text, FIGURES) == text
    with pytest.raises(InputError, match="once each"):
        with_table("no markers", figures)


def test_the_readme_has_the_claims_and_verdicts_of_the_studies() -> None:
    block = README.read_text().split(BEGIN)[1].split(END)[0]
    found: dict[str, dict[str, bool]] = {}
    for part in block.split("<details>")[1:]:
        name = re.findall(r"<summary>(\w+):", part)[0]
        rows = re.findall(r"^\| (.*?) (?<!\\)\| .* \| (yes|no) \|$", part, re.MULTILINE)
        found[name] = {claim.replace("\\|", "|"): word == "yes" for claim, word in rows}
    assert found == VERDICTS
    every = [held for study in VERDICTS.values() for held in study.values()]
    assert f"Of {len(every)} claims {sum(every)} hold;" in block
