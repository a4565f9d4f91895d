"""The store on the command line: listing, filters, tags, ``@last``, ``rm``, export, location."""

from __future__ import annotations

import csv
import json
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from ocp import store
from ocp.store.lookup import find_run
from reports.cli.app import main
from reports.cli.runs_command import parse_date


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a store with three solves and a continuation, each about a second after the last."""
    root = tmp_path_factory.mktemp("store")
    small = ["-p", "N=4", "--quiet", "--out", str(root)]
    for line in (
        ["solve", "wall-1d", "--contact", "barrier", "--tag", "first", "--tag", "both"],
        ["solve", "wall-1d", "--contact", "barrier", "-c", "mu=1e-2", "--tag", "both"],
        [
            "continue",
            "wall-1d",
            "--contact",
            "barrier",
            "--over",
            "mu",
            "--from",
            "1e-1",
            "--to",
            "1e-2",
            "--steps",
            "2",
        ],
        ["solve", "push-1d", "--contact", "exact"],
    ):
        assert main([*line, *small]) == 0
    return root


@pytest.fixture
def runs(ocp, stored: Path, tmp_path: Path) -> Path:
    """Return a copy of the store in the working directory of a test."""
    return shutil.copytree(stored, tmp_path / "runs")


@pytest.mark.costly
def test_the_listing_tells_whole_names_and_what_was_asked(ocp, runs: Path) -> None:
    told = ocp("runs").out
    lines = told.splitlines()
    assert max(map(len, lines)) <= 80
    for entry in store.list_runs(runs):
        assert entry.path.name in told
    assert lines[0].startswith("@4 ") and lines[-2].startswith("@1 ")
    assert "barrier mu=0.001, direct, open-loop, N=4, 1 scenario, tagged both first" in told
    assert "continue over contact.mu, barrier mu=0.001" in told
    assert "exact, direct" in lines[-1]


@pytest.mark.costly_cases("filters0-places0", "filters1-places1", "filters2-places2")
@pytest.mark.parametrize(
    ("filters", "places"),
    [
        ([], ["@4", "@3", "@2", "@1"]),
        (["--problem", "push-1d"], ["@1"]),
        (["--contact", "barrier"], ["@4", "@3", "@2"]),
        (["--kind", "solve", "--contact", "barrier"], ["@4", "@3"]),
        (["--status", "solved"], ["@4", "@3", "@2", "@1"]),
        (["--status", "survives"], ["@1"]),
        (["--tag", "both"], ["@4", "@3"]),
        (["--tag", "both", "--tag", "first"], ["@4"]),
        (["--since", "1h"], ["@4", "@3", "@2", "@1"]),
        (["--since", "2090-01-01"], []),
        (["-n", "2"], ["@2", "@1"]),
        (["--method", "direct", "--last", "1"], ["@1"]),
        (["--algorithm", "ars"], []),
    ],
)
def test_filters(ocp, runs: Path, filters: list[str], places: list[str]) -> None:
    done = ocp("runs", *filters, "--json")
    assert done.code == 0
    listed = done.json["runs"]
    if "survives" in filters:
        assert {run["grade"] for run in listed} <= {"survives"}
    else:
        assert [run["at"] for run in listed] == places


def test_an_empty_answer_tells_what_there_is(ocp, runs: Path) -> None:
    told = ocp("runs", "--contact", "barier").out
    assert "No run matches (4 in" in told and "contact: barrier, exact" in told


@pytest.mark.costly
def test_a_run_is_named_from_the_latest_back(ocp, runs: Path) -> None:
    ages = [entry.path for entry in store.list_runs(runs)]
    created = [json.loads((path / "meta.json").read_text())["created"] for path in ages]
    assert created == sorted(created), "in order, also those of one second"
    assert [find_run(text, runs) for text in ("@last", "@1", "@2", "@4")] == [
        ages[-1],
        ages[-1],
        ages[-2],
        ages[0],
    ]
    assert ocp("replay", "@last", "--json").json["run"].endswith(ages[-1].name)
    assert ocp("solve", "wall-1d", "--contact", "barrier", "-p", "N=6", "--from", "@4", "-q").code == 0
    assert "resumed" not in ocp("runs", "@1").err
    assert ocp("report", "@2", "-o", "a.pdf").code == 0
    done = ocp("runs", "@9")
    assert done.code == 2 and "holds 5 runs" in done.err


def test_tags_are_no_part_of_the_answer(ocp, runs: Path) -> None:
    first = ocp("runs", "--tag", "first", "--json").json["runs"][0]
    same = ocp("solve", "wall-1d", "--contact", "barrier", "-p", "N=4", "--quiet", "--json").json
    assert same["hash"] == first["hash"]
    assert first["tags"] == ["both", "first"]
    assert ocp("runs", first["run"], "--json").json["tags"] == ["both", "first"]
    done = ocp("solve", "wall-1d", "--contact", "barrier", "--tag", "two words")
    assert done.code == 2 and "one word" in done.err
    assert "has no runs" in ocp("runs", "--out", "other").out


@pytest.mark.costly_cases("command0")
@pytest.mark.parametrize(
    "command",
    [
        [
            "continue",
            "wall-1d",
            "--contact",
            "barrier",
            "--over",
            "mu",
            "--from",
            "0.1",
            "--to",
            "0.01",
            "--steps",
            "1",
        ],
        ["estimate", "heaviside", "-n", "100"],
        ["train", "ball-throw", "-s", "samples=2", "-p", "horizon=3", "--iterations", "1"],
    ],
)
def test_every_command_that_stores_a_run_takes_tags(ocp, command: list[str]) -> None:
    assert ocp(*command, "--tag", "mine", "--quiet").code == 0
    assert [run["kind"] for run in ocp("runs", "--tag", "mine", "--json").json["runs"]] == [command[0]]


def test_the_store_is_where_the_environment_says(ocp, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("OCP_RUNS", str(tmp_path / "shelf"))
    assert store.default_root() == tmp_path / "shelf"
    found = ocp("solve", "wall-1d", "--contact", "barrier", "-p", "N=4", "--json", "-q").json["run"]
    assert Path(found).parent == tmp_path / "shelf" / "wall-1d"
    assert store.find_run("@last") == Path(found)
    assert len(ocp("runs", "--json").json["runs"]) == 1
    assert ocp("runs", "--out", "elsewhere", "--json").json["runs"] == [], "what is said counts"
    monkeypatch.delenv("OCP_RUNS")
    assert store.default_root() == Path("runs")


def test_rm_deletes_runs_and_nothing_else(ocp, runs: Path, tmp_path: Path) -> None:
    paths = [entry.path for entry in store.list_runs(runs)]
    (paths[0] / "meta.json").write_text("{")
    done = ocp("runs", "rm", "@1", "@4", "--json")
    assert done.code == 0 and len(done.json["removed"]) == 2
    assert [entry.path for entry in store.list_runs(runs)] == paths[1:3], "a damaged one too"
    assert not (runs / "push-1d").exists(), "nor an empty place of its problem"
    (tmp_path / "precious").mkdir()
    (tmp_path / "precious" / "meta.json").write_text("mine")
    (tmp_path / "precious" / "thesis.tex").write_text("mine")
    for other in (str(tmp_path / "precious"), str(tmp_path), str(runs), "@7", "push"):
        refused = ocp("runs", "rm", "@1", other)
        assert refused.code == 2, other
    assert [entry.path for entry in store.list_runs(runs)] == paths[1:3], "all or none"
    assert (tmp_path / "precious" / "thesis.tex").exists()


def rows(file: Path) -> list[dict[str, str]]:
    with file.open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_csv_has_a_row_a_node(ocp, runs: Path, tmp_path: Path) -> None:
    run = store.load(find_run("@1", runs))
    assert ocp("runs", "export", "@1", "-o", "a.csv").code == 0
    table = rows(tmp_path / "a.csv")
    assert [(row["scenario"], row["node"]) for row in table] == [("0", str(n)) for n in range(5)]
    x, u = run.data["x"].values[0], run.data["u"].values[0]
    assert [float(row["x.qu [m]"]) for row in table] == list(x[:, 0]), "to the last digit"
    assert [float(row["u.u [m]"]) for row in table[:-1]] == list(u[:, 0])
    assert table[-1]["u.u [m]"] == "", "no input is left at the last node"
    assert [float(row["time [s]"]) for row in table] == list(run.data["time"].values)


def test_csv_of_a_continuation_has_a_row_a_point_and_node(ocp, runs: Path, tmp_path: Path) -> None:
    run = store.load(find_run("@2", runs))
    ocp("runs", "export", "@2", "-o", "a.csv")
    table = rows(tmp_path / "a.csv")
    points = run.data.sizes["point"]
    assert len(table) == points * 5
    head = next(name for name in table[0] if name.startswith("x."))
    assert [float(row[head]) for row in table] == list(run.data["x"].values[:, 0, :, 0].ravel())
    assert [float(row["cost"]) for row in table[::5]] == list(run.data["cost"].values)


def test_csv_of_an_estimate(ocp, tmp_path: Path) -> None:
    found = ocp("estimate", "heaviside", "-n", "200", "--sweep", "sigma=0.1:1:2", "--json").json
    ocp("runs", "export", "@last", "-o", "a.csv")
    table = rows(tmp_path / "a.csv")
    told = [(e["estimator"], e["mean"]) for e in found["estimates"]]
    assert [(row["estimator"], float(row["mean.theta"])) for row in table] == told


def test_npz_holds_every_array_and_what_was_asked(ocp, runs: Path, tmp_path: Path) -> None:
    run = store.load(find_run("@1", runs))
    assert ocp("runs", "export", "@1", "--format", "npz", "-o", "a.dat").code == 0
    with np.load(tmp_path / "a.dat", allow_pickle=False) as found:
        assert set(found) == {*map(str, run.data.variables), "meta"}
        np.testing.assert_array_equal(found["x"], run.data["x"].values)
        assert list(found["state"]) == list(run.data["state"].values)
        assert json.loads(str(found["meta"])) == run.meta


def test_what_cannot_be_exported_is_told(ocp, runs: Path, tmp_path: Path) -> None:
    unknown = ocp("runs", "export", "@1", "-o", "a.xlsx")
    assert unknown.code == 2 and "csv, npz" in unknown.err
    data = store.load(find_run("@1", runs)).data
    told = {"argv": [], "record": {}, "status": "done", "verdict": "All hold.", "claims": []}
    store.write_run(runs, "A1", data, {"kind": "figure", **told})
    figure = ocp("runs", "export", "@last", "-o", "a.csv")
    assert figure.code == 2 and "--format npz" in figure.err
    assert not (tmp_path / "a.csv").exists()
    assert ocp("runs", "export", "@last", "-o", "a.npz").code == 0


def test_since_is_a_date_or_a_time_ago() -> None:
    now = datetime.now(UTC)
    assert abs(parse_date("90m") - (now - timedelta(minutes=90))) < timedelta(seconds=5)
    assert abs(parse_date("2w") - (now - timedelta(days=14))) < timedelta(seconds=5)
    assert parse_date("2026-01-31") == datetime(2026, 1, 31, tzinfo=UTC)
    assert parse_date("2026-01-31T12:00+02:00") == datetime(2026, 1, 31, 10, tzinfo=UTC)


@pytest.mark.parametrize("text", ["yesterday", "2x", "-1h", "1.5h", "", "h", "२h", "99999999999w"])
def test_no_time_is_told_what_is(ocp, text: str) -> None:
    done = ocp("runs", "--since", text)
    assert done.code == 2 and ("2026-01-31" in done.err or "empty" in done.err)


def test_one_run_and_filters_exclude_each_other(ocp, runs: Path) -> None:
    done = ocp("runs", "@1", "--tag", "a")
    assert done.code == 2 and "drop --tag" in done.err
    shutil.rmtree(runs)
    assert "there is no run" in ocp("runs", "@1").err


def test_a_folder_of_an_odd_name_is_shown_and_not_obeyed(ocp, tmp_path: Path) -> None:
    (tmp_path / "runs/wall-1d/20990101T000000Z-\x1b[31m").mkdir(parents=True)
    listed = ocp("runs").out
    assert "\x1b" not in listed and r"\x1b[31m  wall-1d  damaged" in listed


def test_a_listing_reads_the_latest_hundred_and_says_so(ocp, runs: Path, monkeypatch) -> None:
    monkeypatch.setattr("reports.cli.runs_command._SHOWN", 2)
    done = ocp("runs")
    assert done.code == 0
    assert done.out.count("@") == 2
    assert "2 older runs were not read; list all with -n 4" in done.out
    assert len(json.loads(ocp("runs", "--json").out)["runs"]) == 2
    assert json.loads(ocp("runs", "--json").out)["older"] == 2
    assert len(json.loads(ocp("runs", "-n", "4", "--json").out)["runs"]) == 4
