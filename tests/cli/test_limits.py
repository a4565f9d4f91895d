"""Requests that are too large are rejected before any work; long ones are announced."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from pathlib import Path

import pytest

from ocp.continuation import walk
from ocp.problem import resources
from ocp.solve.judging import judge_outcome
from reports.cli.streams import Output

WALL = ("solve", "wall-1d", "--contact", "barrier")
TOO_MUCH = {
    "stages of a homotopy": ([*WALL, "-s", "factor=0.999999"], "4.61e+06 stages"),
    "ends of a homotopy": ([*WALL, "-s", "homotopy_start=1e300", "-c", "mu=1e-300"], "too far below"),
    "steps": ([*WALL, "-p", "N=1e8"], "2.72e+03 GB of memory"),
    "steps beyond counting": ([*WALL, "-p", "N=1e23"], "a whole number >= 1, got '1e23'"),
    "steps of feedback": (
        ["solve", "push-disc", "--contact", "barrier", "-p", "N=900000", "--policy", "feedback"],
        "GB of memory",
    ),
    "nodes of a law": (
        ["solve", "half-cheetah", "--contact", "randomized", "-c", "samples=4096", "-p", "N=200"],
        "816 GB of memory",
    ),
    "solves in parallel": (
        [*WALL, "-p", "N=100000", "--starts", "1000", "--jobs", "1000"],
        "1000 solves in parallel",
    ),
    "points": (["sweep", "wall-1d", "--contact", "barrier", "--over", "m=1:2:1e9"], "from 2 to 100000"),
    "points together": (
        ["sweep", "wall-1d", "--contact", "barrier", "--over", "m=1:2:20000", "-p", "N=100000"],
        "a grid of 20000 points",
    ),
    "points of a growing horizon": (
        ["sweep", "wall-1d", "--contact", "barrier", "--over", "N=1:50000:50000"],
        "a grid of 50000 points",
    ),
    "steps of a curve": (
        [
            "continue",
            "wall-1d",
            "--contact",
            "barrier",
            "--over",
            "m",
            "--from",
            "1",
            "--to",
            "2",
            "--steps",
            "100000",
            "-p",
            "N=20000",
        ],
        "--steps 100000 would take",
    ),
    "values": (["estimate", "coulomb", "--sweep", "nu=0.1:1:1e9"], "from 1 to 100000"),
    "samples": (["estimate", "heaviside", "-n", "1e300"], "at most 9.2e+18"),
    "noise": (["estimate", "belt-block", "--sigma", "1e308"], ">= 1e-150 and <= 1e+150"),
    "noise of no effect": (["estimate", "wall-1d", "--sigma", "1e-100"], "must be from 5e-11"),
    "noise as a parameter": (["estimate", "coulomb", "-p", "sigma=1e80"], "must be from"),
    "noise of a sweep": (
        ["estimate", "belt-block", "--sweep", "sigma=1e-300:1:2"],
        "must be from 1e-10",
    ),
    "transitions": (["collect", "wall-1d", "-n", "1e15", "-o", "x.nc"], "GB of memory"),
    "unrolls": (["train", "ball-throw", "-s", "samples=1e12"], "GB of memory"),
    "iterations": (["train", "ball-throw", "--iterations", "1e18"], "GB of memory"),
    "units": (["train", "hopper", "-s", "hidden=100000,100000"], "GB of memory"),
    "batch": (["train", "hopper", "-a", "mbpo", "-s", "batch=1e13"], "GB of memory"),
    "points of a figure": (["figure", "A1", "-p", "points=100000000"], "500 GB of memory"),
    "samples of a figure": (["figure", "P1", "-p", "n_samples=1e15"], "GB of memory"),
    "frames per second": (["animate", "x", "-o", "x.gif", "--fps", "1e9"], "--fps"),
}


@pytest.mark.costly_cases(
    "nodes of a law",
    "points together",
    "points of a growing horizon",
    "batch",
    "stages of a homotopy",
    "steps of feedback",
    "solves in parallel",
    "noise",
    "noise of no effect",
    "noise of a sweep",
    "units",
)
@pytest.mark.parametrize(("words", "sentence"), TOO_MUCH.values(), ids=TOO_MUCH)
def test_what_cannot_be_is_refused(ocp, monkeypatch, words: list[str], sentence: str) -> None:
    monkeypatch.setattr(resources, "machine_memory", lambda: 25e9)
    done = ocp(*words)
    assert done.code == 2 and done.out == ""
    assert sentence in done.err and len(done.err.splitlines()) == 1


@pytest.mark.costly
def test_what_will_take_long_is_told_in_one_line(ocp, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resources, "LONG", 1e-3)
    told = ocp(*WALL, "-p", "N=5", "--json")
    assert told.json["success"]
    first = told.err.splitlines()[0]
    assert first == "wall-1d will take longer than a minute (an estimate)"
    assert "will take" not in ocp(*WALL, "-p", "N=5", "--quiet").err
    monkeypatch.setattr(resources, "LONG", 60.0)
    assert "will take" not in ocp(*WALL, "-p", "N=5").err


def test_the_line_has_time_and_what_matters_of_memory(capsys) -> None:
    output = Output(as_json=False, quiet=False)
    output.announce("this", 59.0, 1e12)
    output.announce("this", 7200.0, 5e9)
    output.announce("this", 300.0, 5e8)
    assert capsys.readouterr() == (
        "",
        "this will take longer than a minute and 5 GB of memory (an estimate)\n"
        "this will take longer than a minute (an estimate)\n",
    )


@pytest.mark.costly
def test_a_curve_that_ends_in_no_number_has_failed(ocp, monkeypatch: pytest.MonkeyPatch) -> None:
    """For m >= 0.75 the exact replay overflows."""

    def overflown(session, outcome, seed):
        found = judge_outcome(session, outcome, seed)
        lost = inf if session.values["m"] < 0.8 else found.audit.exact_cost
        return replace(found, audit=replace(found.audit, exact_cost=lost))

    monkeypatch.setattr(walk, "judge_outcome", overflown)
    monkeypatch.setattr(walk, "MIN_STEP_SHARE", 0.9)
    done = ocp(
        "continue",
        "wall-1d",
        "--contact",
        "barrier",
        "--over",
        "m",
        "--from",
        "1",
        "--to",
        "0.5",
        "--steps",
        "1",
        "-p",
        "N=3",
        "--json",
    )
    assert done.code == 3 and done.json["success"] is False
    assert "its cost, replayed, is not finite" in done.json["verdict"]
    assert all(point["exact_cost"] is not None for point in done.json["points"])


@pytest.mark.costly
def test_a_solve_whose_replay_has_no_number_has_failed(ocp) -> None:
    done = ocp(*WALL, "-p", "N=5", "-p", "m=1e-300", "--json")
    assert done.json["exact_cost"] is None and done.code == 3
    again = ocp("replay", "@last", "--json")
    assert again.json["cost"] is None and again.code == 3


@pytest.mark.costly
def test_a_tilde_is_the_home_directory(ocp, tmp_path: Path, monkeypatch) -> None:
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.setenv("HOME", str(home))
    assert ocp(*WALL, "-p", "N=3", "--out=~/kept", "--pdf=~/a.pdf", "-q").code == 0
    (run,) = (home / "kept" / "wall-1d").iterdir()
    assert (home / "a.pdf").stat().st_size > 1000
    assert ocp("replay", f"~/kept/wall-1d/{run.name}", "-q").code == 0
    monkeypatch.setenv("OCP_RUNS", "~/kept")
    assert ocp("replay", "@last", "-q").code == 0
    done = ocp(*WALL, "--out=~no-such-user/x")
    assert done.code == 2 and "no user called no-such-user" in done.err
    assert not list(tmp_path.glob("~*"))
