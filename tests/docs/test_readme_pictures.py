"""The README has one strobe picture and one animation for each problem, none too large for a page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from docs.generator import readme_pictures
from ocp.errors import InputError
from tests.unit.reports.made import sliding_box

NORMAL = np.ones((2, 2))


@pytest.mark.parametrize(("count", "rows", "columns"), [(1, 1, 1), (3, 1, 3), (5, 2, 3)])
def test_strobes_stand_in_rows_of_three(count: int, rows: int, columns: int) -> None:
    figure = readme_pictures.picture([sliding_box(NORMAL, NORMAL)] * count)
    assert [axis.get_title() for axis in figure.axes] == ["A box that slides"] * count
    grids = [axis.get_subplotspec().get_gridspec() for axis in figure.axes]
    assert {(grid.nrows, grid.ncols) for grid in grids} == {(rows, columns)}


def test_every_problem_gets_its_animation(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(readme_pictures, "newest", lambda root, name: sliding_box(NORMAL, NORMAL))
    files = readme_pictures.draw(tmp_path, tmp_path, ["box"], ["box"])
    assert [file.name for file in files] == ["strobes.png", "box.gif"]
    with Image.open(files[1]) as movie:
        assert movie.n_frames == 6
    monkeypatch.setattr(readme_pictures, "LARGEST", 1000)
    with pytest.raises(InputError, match=r"box\.gif has 0\.\d MB, at most 0\.001"):
        readme_pictures.draw(tmp_path, tmp_path, ["box"], ["box"])


def test_a_problem_without_a_run_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no run of hopper; ocp solve hopper --out"):
        readme_pictures.newest(tmp_path, "hopper")
