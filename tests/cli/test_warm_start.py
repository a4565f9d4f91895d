"""``ocp solve --from RUN`` starts from a stored run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

PUSH = ("solve", "push-disc", "--contact", "barrier", "-c", "mu=1e-3")


@pytest.mark.costly
def test_a_finer_mesh_starts_at_a_stored_run(ocp) -> None:
    first = ocp(*PUSH, "--json", "--quiet").json
    finer = ("-p", "N=40", "-p", "h=0.05", "--json", "--quiet")
    cold = ocp(*PUSH, *finer).json
    warm = ocp(*PUSH, *finer, "--from", first["run"]).json
    assert warm["success"] and warm["cost"] == pytest.approx(cold["cost"], rel=1e-6)
    assert warm["iterations"] < cold["iterations"] / 2
    assert warm["from"] == first["hash"] and cold["from"] is None
    assert warm["hash"] != cold["hash"]
    again = ocp(*PUSH, "-p", "M=1.1", "--json", "--quiet", "--from", Path(warm["run"]).name).json
    assert again["from"] == warm["hash"], "a run is named by a part of its name too"


@pytest.mark.costly
def test_what_cannot_be_started_from_is_said_in_one_line(ocp, store_of_runs: Path) -> None:
    def refused(*arguments: str, words: str, code: int = 2) -> None:
        done = ocp(*arguments)
        assert done.code == code
        assert words in done.err and done.err.count("\n") == 1, done.err

    here = ("--out", str(store_of_runs))
    refused(*PUSH, "--from", "nothing", words="there is no run 'nothing'")
    refused(*PUSH, "--from", "push-1d", *here, words="names 2 runs")
    wall = next(p for p in (store_of_runs / "wall-1d").iterdir() if kind(p) == "solve")
    refused(*PUSH, "--from", str(wall), words="solves wall-1d, not push-disc")
    path = next(p for p in (store_of_runs / "wall-1d").iterdir() if kind(p) == "continue")
    refused(
        "solve",
        "wall-1d",
        "--contact",
        "barrier",
        "--from",
        str(path),
        words="expected a run of ocp solve",
    )
    refused(
        "solve",
        "wall-1d",
        "--contact",
        "barrier",
        "--from",
        str(wall),
        "--starts",
        "2",
        words="excludes several starts",
    )
    run = ocp("solve", "wall-1d", "--contact", "barrier", "--json", "--quiet").json["run"]
    (Path(run) / "solution.nc").write_bytes(b"")
    refused("solve", "wall-1d", "--contact", "barrier", "--from", run, words="checksum", code=4)


def kind(run: Path) -> str:
    return json.loads((run / "meta.json").read_text())["kind"]
