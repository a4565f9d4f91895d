"""``ocp figure``: files, claims, reproducible bytes, and rejected input."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import xarray as xr

from ocp import store
from problems import studies

Ocp = Callable[..., Any]


@pytest.mark.costly
def test_files_run_and_claims_of_one_figure(ocp: Ocp, tmp_path: Path) -> None:
    done = ocp("figure", "p6", "--json", "--quiet", "--out", "here")
    assert done.code == 0
    answer = done.json
    assert answer["id"] == "P6"
    assert answer["files"] == ["here/P6.pdf", "here/P6.nc"]
    for claim in answer["claims"]:
        assert set(claim) == {"claim", "source", "expected", "measured", "holds", "margin"}
    assert (tmp_path / "here/P6.pdf").read_bytes().startswith(b"%PDF")
    data = xr.load_dataset(tmp_path / "here/P6.nc")
    assert data["x_barrier"].attrs["units"] == "m"
    assert data.attrs["h"] == 0.1
    stored = store.load(tmp_path / answer["run"])
    assert stored.kind == "figure"
    assert stored.meta["claims"] == answer["claims"]
    assert stored.data["x_barrier"].equals(data["x_barrier"])


@pytest.mark.costly
def test_same_seed_same_bytes_and_parameters_are_taken(ocp: Ocp, tmp_path: Path) -> None:
    for place in ("one", "two"):
        assert (
            ocp(
                "figure",
                "P2",
                "-p",
                "n_samples=20",
                "-p",
                "points=10",
                "--seed",
                "3",
                "--out",
                place,
            ).code
            == 0
        )
    for name in ("P2.pdf", "P2.nc"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    assert xr.load_dataset(tmp_path / "one/P2.nc").attrs["n_samples"] == 20
    ocp("figure", "P2", "-p", "n_samples=20", "-p", "points=10", "--seed", "4", "--out", "two")
    assert (tmp_path / "one/P2.nc").read_bytes() != (tmp_path / "two/P2.nc").read_bytes()


@pytest.mark.costly
def test_the_table_fits_80_columns_and_shows_every_claim(ocp: Ocp) -> None:
    done = ocp("figure", "P6")
    assert all(len(line) <= 80 for line in done.err.splitlines())
    assert done.err.count("yes") >= 8
    assert "P6: 8 of 8 claims hold." in done.out


@pytest.mark.costly
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
        (("--all", "-p", "m=2"), "-p sets a parameter of one study"),
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


@pytest.mark.costly
@pytest.mark.parametrize(("ending", "begins"), [("pdf", b"%PDF"), ("svg", b"<?xml"), ("png", b"\x89PNG")])
def test_a_bare_figure_beside_the_report(ocp: Ocp, tmp_path: Path, ending: str, begins: bytes) -> None:
    done = ocp("figure", "P2", "-p", "n_samples=20", "-p", "points=10", "--format", ending, "--json", "-q")
    assert done.code == 0, done.err
    assert done.json["files"][2] == f"runs/P2-figure.{ending}"
    assert (tmp_path / "runs/P2-figure").with_suffix(f".{ending}").read_bytes().startswith(begins)
    assert (tmp_path / "runs/P2.pdf").exists()


@pytest.mark.costly
def test_a_stored_figure_is_drawn_again_without_computing(
    ocp: Ocp, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ("P2", "P6")
    done = ocp("figure", *names, "--quick", "--panel", "b", "--json", "-q")
    assert done.code == 0, done.err
    files = [figure["files"][2] for figure in done.json["figures"]]
    assert files == ["runs/P2-b.pdf", "runs/P6-b.pdf"]
    before = (tmp_path / files[1]).read_bytes()
    (tmp_path / files[1]).unlink()
    study = studies.get("P6")
    monkeypatch.setattr(type(study), "data", None)
    again = ocp("figure", done.json["figures"][1]["run"], "--panel", "b", "--json", "-q")
    assert again.code == 0, again.err
    assert again.json["files"] == [files[1]]
    assert (tmp_path / files[1]).read_bytes() == before
    lost = ocp("figure", "P6/", "--panel", "c")
    assert lost.code == 2 and "unknown panel 'c'; the figure has a to b" in lost.err


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("P6", "--format", "eps"), "unknown format 'eps'; there are pdf, svg, png"),
        (("P6", "--panel", "1"), "--panel must be a letter from a to z, got '1'"),
        (("nowhere/", "--panel", "a"), "there is no run 'nowhere/'"),
    ],
)
def test_a_bare_figure_that_cannot_be_is_told_before_any_work(
    ocp: Ocp, tmp_path: Path, arguments: tuple[str, ...], sentence: str
) -> None:
    done = ocp("figure", *arguments)
    assert done.code == 2 and sentence in done.err
    assert not list(tmp_path.rglob("*.nc"))


@pytest.mark.costly_cases("words2-A6 has no result at g=1000000000.0")
@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["A2v", "-p", "first=3"], "first = 3 s, must not come after the latest, last = 1 s"),
        (["A2v", "-p", "last=1e-9"], "must be a number >= 0.02 [s]"),
        (["A6", "-p", "g=1e9"], "A6 has no result at g=1000000000.0"),
    ],
)
def test_a_study_at_values_that_have_no_answer(ocp, words: list[str], said: str) -> None:
    done = ocp("figure", *words, "--quiet")
    assert done.code == 2
    assert said in done.err and "internal error" not in done.err
    assert done.err.count("\n") == 1


def test_a_study_that_fails_at_its_own_values_is_a_defect(ocp, monkeypatch) -> None:
    def fails(*_: object) -> None:
        raise ValueError("odd")

    monkeypatch.setattr("problems.studies.study.FigureStudy.data", fails)
    assert "internal error, ValueError: odd" in ocp("figure", "A1").err
    assert "A1 has no result at sigma=2.0 (odd)" in ocp("figure", "A1", "-p", "sigma=2").err
