"""Claims of the figures on the site: their storage, and agreement with the tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from docs.generator import figures, law_tables, measured
from ocp.errors import InputError
from problems.studies.study import count_text
from tests.golden.figures.compared import compared
from tests.golden.figures.verdicts import VERDICTS

CLAIMS = [
    {"claim": "|a_b| < 1", "source": "s", "expected": "e", "measured": "0.5", "holds": True},
    {"claim": "b", "source": "s", "expected": "e", "measured": "2", "holds": False},
]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(measured, "DOCS", tmp_path)
    monkeypatch.setattr(measured, "DATA", tmp_path / "data")
    return tmp_path


def test_claims_are_kept_with_where_they_come_from(folder: Path) -> None:
    (file,) = figures.keep([{"id": "P1", "claims": CLAIMS}])
    assert file == folder / "data" / "claims" / "P1.json"
    kept = measured.read("claims/P1")
    assert kept["claims"] == CLAIMS and kept["command"] == "ocp figure P1"
    assert all(kept[name] for name in ("commit", "date", "machine"))
    assert count_text(kept["claims"]) == "1 of 2"
    noisy = [{**claim, "margin": margin} for claim, margin in zip(CLAIMS, (2.9, -3.1), strict=True)]
    figures.keep([{"id": "P1", "claims": noisy}])
    kept_noisy = measured.read("claims/P1")
    assert kept_noisy["claims"] == noisy and count_text(kept_noisy["claims"]) == "0 of 2 (1 within noise)"
    assert figures.claims(kept_noisy).splitlines()[2].endswith("| within noise |")
    rows = figures.claims(kept).splitlines()
    assert rows[2].startswith("| \\|a\\_b\\| &lt; 1 |") and rows[2].endswith("| yes |")
    assert rows[3].endswith("| **no** |")


def test_a_figure_that_is_none_is_refused(folder: Path) -> None:
    with pytest.raises(InputError, match="figure"):
        figures.keep([{"id": "X1", "claims": CLAIMS}])


def test_picture_and_table_of_smoothings_are_made_from_the_file(folder: Path) -> None:
    made = compared(lambda key: (1.0, 1.0 if "exact" in key else 1.05))
    file = folder / "N3.nc"
    made.to_netcdf(file, engine="scipy", format="NETCDF3_64BIT")
    files = [str(folder / "N3.pdf"), str(file)]
    figures.keep([{"id": "N3", "claims": CLAIMS, "files": files}])
    table = measured.read("smoothings")
    assert [table["columns"], *table["rows"]] == law_tables.smoothing_rows(made)
    assert (folder / "pictures" / "figures" / "N3.png").read_bytes().startswith(b"\x89PNG")


def test_the_site_has_the_claims_and_verdicts_of_the_studies() -> None:
    found = {
        name: {claim["claim"]: claim["holds"] for claim in figure["claims"]}
        for name, figure in figures.measured().items()
    }
    assert found == VERDICTS
    every = [held for study in VERDICTS.values() for held in study.values()]
    assert f"of {len(every)}" in figures.index(figures.measured()).splitlines()[2]
