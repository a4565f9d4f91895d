"""``ocp sweep``: one stored study, printed, drawn and resumed; ``ocp solve --starts --jobs``."""

from __future__ import annotations

import csv
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ocp import store
from reports.cli.app import main
from tests.cli.conftest import Ocp

ROOT = Path(__file__).parents[2]
KEPT = "*/.unfinished-*/point-*.json"
OVER = ("--contact", "barrier", "--over", "M=0.5:2:3", "--over", "mu=1e-3:1e-2:2:log", "-p", "N=6")


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a store with one sweep, two of whose points fail, which tests only read."""
    root = tmp_path_factory.mktemp("swept")
    over = ["--over", "qa0=-0.5:-0.2:2", "--over", "width=0.2:0.4:3"]
    assert (
        main(
            [
                "sweep",
                "push-1d",
                "--contact",
                "barrier",
                *over,
                "-p",
                "N=6",
                "--out",
                str(root),
                "--quiet",
            ]
        )
        == 3
    )
    return root


@pytest.mark.costly
def test_each_point_is_told_and_stored_as_a_solve_of_its_own(ocp: Ocp) -> None:
    done = ocp("sweep", "push-1d", *OVER, "--json")
    assert done.code == 0, done.err
    told = done.json
    assert [axis["name"] for axis in told["axes"]] == ["M", "contact.mu"]
    assert len(told["points"]) == 6 and told["solved"] == 6 and told["failed"] == []
    run = store.load(told["run"])
    assert run.kind == "sweep" and run.data["cost"].dims == ("M", "contact.mu")
    point = told["points"][3]
    assert (point["M"], point["contact.mu"]) == (1.25, 1e-2)
    alone = ocp(
        "solve",
        "push-1d",
        "-p",
        "N=6",
        "-p",
        "M=1.25",
        "--contact",
        "barrier",
        "-c",
        "mu=0.01",
        "--json",
    ).json
    names = (
        "cost",
        "exact_cost",
        "referee_cost",
        "status",
        "stationarity",
        "iterations",
        "verdict",
        "complementarity",
        "grade",
    )
    assert {name: point[name] for name in names} == {name: alone[name] for name in names}
    assert bool(point["survives"]) == alone["survives"]
    solved = store.load(alone["run"]).data
    kept = run.data.sel({"M": 1.25, "contact.mu": 1e-2})
    assert np.array_equal(kept["x"].values, solved["x"].values)
    assert "All 6 points are solved" in told["verdict"] and "6/6" in done.err


@pytest.mark.costly
def test_failed_points_are_kept_named_and_can_be_looked_at(swept: Path, ocp: Ocp) -> None:
    (directory,) = swept.glob("push-1d/*")
    meta = store.read_meta(directory)
    assert meta["status"] == "4 of 6 solved" and not meta["success"]
    failed = meta["study"]["failed"]
    assert [one["at"] for one in failed] == [{"qa0": -0.2, "width": w} for w in (0.3, 0.4)]
    assert "qa0 = -0.2, width = 0.3: push-1d: the pusher starts inside" in meta["verdict"]
    words = shlex.split(failed[0]["command"])
    assert words[:3] == ["ocp", "solve", "push-1d"]
    assert words[words.index("--contact") + 1] == "barrier"
    assert "starts inside the object" in ocp(*words[1:]).err


@pytest.mark.costly
def test_the_store_shows_a_sweep_and_a_report_draws_it(swept: Path, ocp: Ocp) -> None:
    listed = ocp("runs", "--out", str(swept), "--json").json["runs"]
    told = [(one["kind"], one["status"], one["over"]) for one in listed]
    assert told == [("sweep", "4 of 6 solved", "qa0, width")]
    assert "sweep over qa0, width" in ocp("runs", "--out", str(swept)).out
    table = ocp("runs", "export", listed[0]["run"], "-o", "points.csv")
    assert table.code == 0, table.err
    head, *lines = csv.reader(Path("points.csv").read_text().splitlines(keepends=True))
    assert head[:2] == ["qa0", "width"] and len(lines) == 6
    assert [line[:2] for line in lines[:2]] == [["-0.5", "0.2"], ["-0.5", "0.3"]]
    done = ocp("report", listed[0]["run"], "-o", "sweep.pdf", "--json")
    assert done.code == 0, done.err
    assert Path("sweep.pdf").read_bytes().startswith(b"%PDF")


def _stopped(words: list[str], store_of: Path, stop: signal.Signals) -> subprocess.Popen[str]:
    """Start a sweep in its own process and stop it after its first point is stored."""
    code = f"import sys\nfrom reports.cli.app import main\nsys.exit(main({words!r}))"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    end = time.monotonic() + 120
    while not list(store_of.glob(KEPT)) and time.monotonic() < end:
        time.sleep(0.02)
    process.send_signal(stop)
    return process


@pytest.mark.costly_cases("2")
@pytest.mark.parametrize("stop", [signal.SIGKILL, signal.SIGINT])
def test_the_same_command_goes_on_after_a_kill_or_ctrl_c(stop: signal.Signals, tmp_path: Path, ocp: Ocp) -> None:
    kept = tmp_path / "kept"
    words = [
        "sweep",
        "push-1d",
        "--contact",
        "barrier",
        "--over",
        "M=0.5:2:5",
        "-p",
        "N=3",
        "--out",
        str(kept),
    ]
    process = _stopped([*words, "--jobs", "2"], kept, stop)
    out, err = process.communicate(timeout=120)
    assert process.returncode == (-9 if stop == signal.SIGKILL else 130)
    if stop == signal.SIGINT:
        assert "the same command resumes" in out and "stopped by the user" in err
    before = len(list(kept.glob(KEPT)))
    assert before > 0
    done = ocp(*words, "--json")
    assert done.code == 0 and f"resumed; {before} of 5 points already complete" in done.err
    other = ocp(*words[:-1], str(tmp_path / "other"), "--json")
    assert store.read_meta(Path(done.json["run"]))["hash"] == _hash(other.json)
    assert not list(kept.rglob(".unfinished-*"))


def _hash(told: dict[str, Any]) -> str:
    return store.read_meta(Path(told["run"]))["hash"]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["sweep", "push-1d", "--contact", "barrier"], "a sweep needs a parameter; give --over NAME=A:B:n"),
        (["sweep", "push-1d", "--contact", "barrier", "--over", "M"], "expected NAME=A:B:n"),
        (["sweep", "push-1d", "--contact", "barrier", "--over", "Mass=1:2:2"], "no parameter 'Mass'"),
        (["sweep", "push-1d", "--contact", "barrier", "--over", "M=1:2:2", "-p", "M=3"], "drop its own value"),
        (["sweep", "push-1d", "--contact", "barrier", "--over", "M=-1:2:4"], "must be a number > 0 [kg], got -1"),
        (
            ["sweep", "push-1d", "--contact", "barrier", "--over", "M=1:2:2", "--rank", "exact"],
            "give --starts 2 or more",
        ),
        (
            ["sweep", "push-1d", "--contact", "barrier", "--over", "M=1:2:2", "-j", "2", "--scheduler", "tcp://a:1"],
            "drop one",
        ),
        (["sweep", "push-1d", "--contact", "barrier", "--over", "setting.tl=1e-8:1e-6:2:log"], "tl"),
        (["sweep", "nothing", "--over", "M=1:2:2"], "unknown problem 'nothing'"),
        (["solve", "push-1d", "--contact", "barrier", "--jobs", "2"], "--jobs needs several starts"),
        (["solve", "push-1d", "--contact", "barrier", "--starts", "2", "--rank", "best"], "unknown rank 'best'"),
    ],
)
def test_bad_words_are_told_in_a_sentence(words: list[str], sentence: str, ocp: Ocp) -> None:
    done = ocp(*words)
    assert done.code == 2 and sentence in done.err
    assert len(done.err.strip().splitlines()) <= 2


@pytest.mark.costly
def test_starts_side_by_side_store_the_same_run(ocp: Ocp) -> None:
    words = ["solve", "push-1d", "--contact", "exact", "-p", "N=6", "--starts", "2", "--json"]
    alone, beside = ocp(*words), ocp(*words, "--jobs", "2")
    assert alone.code == beside.code == 0, beside.err
    assert alone.json["hash"] == beside.json["hash"]
    assert [one["chosen"] for one in beside.json["others"]].count(True) == 1
    assert json.dumps(alone.json["others"]) == json.dumps(beside.json["others"])
