"""``ocp figure``: its files, its claims, its bytes, and how it refuses."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import xarray as xr

from ocp import store
from problems import studies

Ocp = Callable[..., Any]


def test_files_run_and_claims_of_one_figure(ocp: Ocp, tmp_path: Path) -> None:
    done = ocp("figure", "p6", "--json", "--quiet", "--out", "here")
    assert done.code == 0
    answer = done.json
    assert answer["id"] == "P6"
    assert answer["files"] == ["here/P6.pdf", "here/P6.nc"]
    for claim in answer["claims"]:
        assert set(claim) == {"claim", "source", "expected", "measured", "holds"}
    assert (tmp_path / "here/P6.pdf").read_bytes().startswith(b"%PDF")
    data = xr.load_dataset(tmp_path / "here/P6.nc")
    assert data["x_barrier"].attrs["units"] == "m"
    assert data.attrs["h"] == 0.1
    stored = store.load(tmp_path / answer["run"])
    assert stored.kind == "figure"
    assert stored.meta["claims"] == answer["claims"]
    assert stored.data["x_barrier"].equals(data["x_barrier"])


def test_same_seed_same_bytes_and_parameters_are_taken(ocp: Ocp, tmp_path: Path) -> None:
    for place in ("one", "two"):
        assert ocp("figure", "A2v", "-p", "n_samples=20", "--seed", "3", "--out", place).code == 0
    for name in ("A2v.pdf", "A2v.nc"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    assert xr.load_dataset(tmp_path / "one/A2v.nc").attrs["n_samples"] == 20
    ocp("figure", "A2v", "-p", "n_samples=20", "--seed", "4", "--out", "two")
    assert (tmp_path / "one/A2v.nc").read_bytes() != (tmp_path / "two/A2v.nc").read_bytes()


def test_the_table_fits_80_columns_and_shows_every_claim(ocp: Ocp) -> None:
    done = ocp("figure", "P6")
    assert all(len(line) <= 80 for line in done.err.splitlines())
    assert done.err.count("yes") >= 8
    assert "P6: 8 of 8 claims hold." in done.out


def test_a_report_of_a_stored_figure_is_the_same_page(ocp: Ocp, tmp_path: Path) -> None:
    run = ocp("figure", "P6", "--json", "-q").json["run"]
    assert ocp("report", run, "-o", "again.pdf").code == 0
    assert (tmp_path / "again.pdf").read_bytes() == (tmp_path / "runs/P6.pdf").read_bytes()


def test_figures_are_listed(ocp: Ocp) -> None:
    listed = {entry["name"] for entry in ocp("list", "--json").json["figures"]}
    assert listed == set(studies.ids())


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((), "give figures or --all"),
        (("P6", "--all"), "give figures or --all"),
        (("--all", "-p", "m=2"), "-p belongs to one figure"),
        (("A2vv",), "unknown figure 'A2vv' (did you mean 'A2v'?); there are"),
        (("P6", "-p", "mas=2"), "unknown parameter 'mas'"),
        (("P6", "-p", "m"), "expected name=value"),
        (("P6", "-p", "kappa=1", "-p", "kappa=2"), "kappa is given twice"),
        (("P6", "-p", "h=0"), "parameter h (step size) must be a number > 0 [s], got '0'"),
        (("P6", "--seed", "-1"), "seed"),
    ],
)
def test_bad_input(ocp: Ocp, arguments: tuple[str, ...], sentence: str) -> None:
    done = ocp("figure", *arguments)
    assert done.code == 2
    assert sentence in done.err
    assert "Traceback" not in done.err


def test_a_place_that_cannot_be_written(ocp: Ocp, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    done = ocp("figure", "P6", "--out", "file")
    assert done.code == 2
    assert "cannot write" in done.err
