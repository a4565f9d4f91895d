"""``ocp solve --plot`` writes the bare figure of the solution and opens no window."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from ocp import store
from reports.figures.paper import BOTH_COLUMNS_IN, bare_figure


@pytest.mark.costly
def test_a_solve_writes_its_figure(ocp, tmp_path: Path) -> None:
    done = ocp(
        "solve",
        "push-1d",
        "--contact",
        "barrier",
        "-p",
        "N=6",
        "--plot",
        "push.png",
        "--json",
        "-q",
    )
    assert done.code == 0, done.err
    assert done.json["plot"] == "push.png"
    with Image.open("push.png") as picture:
        assert picture.size[0] == pytest.approx(300 * BOTH_COLUMNS_IN, abs=1)
    assert Path("push.png").read_bytes() == bare_figure(store.load(Path(done.json["run"])), "png")
    plain = ocp("solve", "push-1d", "--contact", "barrier", "-p", "N=6", "--plot", "again.svg", "-q")
    assert "figure: again.svg\n" in plain.out
    assert Path("again.svg").read_text().startswith("<?xml")
    again = ocp("figure", done.json["run"], "--format", "png", "--json", "-q")
    assert Path(again.json["files"][0]).read_bytes() == Path("push.png").read_bytes()


@pytest.mark.parametrize(
    ("file", "sentence"),
    [
        ("push.gif", "a figure must end in .pdf, .svg or .png, got '.gif'; use push.pdf"),
        ("push", "got ''; use push.pdf"),
        ("taken.pdf", "taken.pdf is a directory"),
    ],
)
def test_a_figure_that_cannot_be_written_is_told_before_solving(ocp, tmp_path: Path, file: str, sentence: str) -> None:
    (tmp_path / "taken.pdf").mkdir()
    done = ocp("solve", "push-1d", "--contact", "barrier", "--plot", file)
    assert done.code == 2 and sentence in done.err and done.out == ""
    assert not (tmp_path / "runs").exists() or not list((tmp_path / "runs").rglob("*.nc"))
