"""Names that matplotlib, typst, HTML or a spreadsheet would execute are set as text on every page."""

from __future__ import annotations

import csv
import shutil
import warnings
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from reports.drawing.style import house_style, show_literally, to_svg
from tests.cli.conftest import Ocp

FILE = "hostile.py"


@pytest.fixture
def hostile(ocp: Ocp, tmp_path: Path) -> Ocp:
    shutil.copy(Path(__file__).with_name(FILE), tmp_path / FILE)
    return ocp


@pytest.mark.cheap_cases("lines4")
@pytest.mark.parametrize(
    "lines",
    [
        [
            "solve hostile.py --policy feedback --pdf a.pdf --plot a.png",
            "report @last -o b.pdf --source hostile.py",
            "report @last -o c.pdf",
            "animate @last -o a.html --source hostile.py",
            "animate @last -o a.gif",
        ],
        ["continue hostile.py --over goal --from 0.2 --to 0.3 --steps 3 --pdf d.pdf", "runs export @last -o d.csv"],
        ["sweep hostile.py --over goal=0.1:0.2:2 --pdf e.pdf"],
        ["estimate hostile.py -n 50 --pdf f.pdf"],
        ["show hostile.py", "export hostile.py -o x.c"],
    ],
)
def test_every_page_is_written_without_a_warning(hostile: Ocp, lines: list[str]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for line in lines:
            done = hostile(*line.split())
            assert done.code == 0, (line, done.err)


@pytest.mark.costly
def test_a_name_is_drawn_as_it_is_and_numbers_at_ticks_stay_mathematics() -> None:
    with house_style():
        figure = Figure()
        axis = figure.subplots()
        axis.semilogy([1, 2], [1e-3, 1e3])
        axis.set(title="x$a$", ylabel="u$_{$", xticks=[1, 2], xticklabels=["$b$", "c$_{$"])
        show_literally(figure)
        to_svg(figure)
        names = {
            text.get_text(): text.get_parse_math()
            for text in axis.findobj(Text)
            if isinstance(text, Text) and text.get_text()
        }
    assert not any(names[name] for name in ("x$a$", "u$_{$", "$b$", "c$_{$"))
    assert all(parsed for text, parsed in names.items() if "mathdefault" in text)
    assert any("mathdefault" in text for text in names)


def test_no_cell_of_a_csv_is_a_formula(hostile: Ocp, tmp_path: Path) -> None:
    assert hostile("solve", FILE).code == 0
    assert hostile("runs", "export", "@last", "-o", "x.csv").code == 0
    rows = list(csv.reader((tmp_path / "x.csv").open()))
    assert any("wa$ll_{^$" in head for head in rows[0])
    for cell in (cell for row in rows for cell in row if cell):
        try:
            float(cell)
        except ValueError:
            assert cell[0] not in "=+-@\t\r"
