"""The command line and Python read all numbers by the same grammar."""

from __future__ import annotations

from pathlib import Path

import pytest

import ocp as workbench
from ocp.errors import InputError
from problems import get
from reports.cli import app

DOORS = {
    "steps of a problem": ["solve", "wall-1d", "-p", "N={}"],
    "parameter": ["solve", "wall-1d", "-p", "m={}"],
    "law": ["solve", "wall-1d", "--contact", "barrier", "-c", "mu={}"],
    "law's count": ["solve", "wall-1d", "--contact", "randomized", "-c", "samples={}"],
    "our setting": ["solve", "wall-1d", "--contact", "barrier", "-s", "factor={}"],
    "solver's setting": ["solve", "wall-1d", "--contact", "barrier", "-s", "tol={}"],
    "solver's count": ["solve", "wall-1d", "--contact", "barrier", "-s", "max_iter={}"],
    "policy": ["solve", "wall-1d", "--contact", "barrier", "--policy", "feedback", "-s", "policy.bound={}"],
    "seed": ["solve", "wall-1d", "--contact", "barrier", "--seed", "{}"],
    "starts": ["solve", "wall-1d", "--contact", "barrier", "--starts={}"],
    "first value": ["continue", "wall-1d", "--contact", "barrier", "--over", "m", "--from", "{}", "--to", "2"],
    "continuation": [
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
        "{}",
    ],
    "end of an axis": ["sweep", "wall-1d", "--contact", "barrier", "--over", "m={}:2:3"],
    "points of an axis": ["sweep", "wall-1d", "--contact", "barrier", "--over", "m=1:2:{}"],
    "parameter of a sweep": ["sweep", "wall-1d", "--contact", "barrier", "--over", "m=1:2:3", "-p", "N={}"],
    "samples": ["estimate", "heaviside", "-n", "{}"],
    "noise": ["estimate", "heaviside", "--sigma", "{}"],
    "estimate's sweep": ["estimate", "heaviside", "--sweep", "theta={}:1:3"],
    "values of it": ["estimate", "heaviside", "--sweep", "theta=0:1:{}"],
    "estimator's rule": ["estimate", "heaviside", "--estimators", "alpha", "-s", "alpha.gamma={}"],
    "transitions": ["collect", "wall-1d", "-o", "x.nc", "--samples", "{}"],
    "task": ["train", "ball-throw", "-p", "h={}"],
    "algorithm": ["train", "ball-throw", "-s", "samples={}"],
    "training": ["train", "ball-throw", "-s", "discount={}"],
    "layers": ["train", "ball-throw", "-s", "hidden=8,{}"],
    "iterations": ["train", "ball-throw", "--iterations", "{}"],
    "study": ["figure", "A1", "-p", "seed={}"],
    "frames": ["animate", "x", "-o", "x.gif", "--fps", "{}"],
    "speed": ["animate", "x", "-o", "x.gif", "--speed", "{}"],
    "runs": ["runs", "--last", "{}"],
}


@pytest.mark.one_case_in(8)
@pytest.mark.parametrize("door", DOORS.values(), ids=DOORS)
def test_what_is_no_number_is_refused_at_every_door(ocp, tmp_path: Path, door: list[str]) -> None:
    for word in ("1_0", "１２", "0x10", "nan", "1e999"):
        done = ocp(*(part.format(word) for part in door))
        assert done.code == 2 and done.out == "", (word, done.err)
        assert word in done.err and ("number" in done.err or "expected" in done.err), done.err
    assert not list(tmp_path.iterdir())


def test_whole_numbers_may_be_written_as_numbers(ocp, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr(app, "execute", lambda options: seen.append(options) or 0)
    ocp(
        "solve",
        "wall-1d",
        "--contact",
        "barrier",
        "--seed",
        " 1e1 ",
        "--starts=+2.0",
        "--jobs",
        "-0",
    )
    ocp("solve", "wall-1d", "--contact", "barrier", "--seed", " 1e1 ", "--starts=+2.0", "-j3e0")
    ocp(
        "continue",
        "wall-1d",
        "--contact",
        "barrier",
        "--over",
        "m",
        "--from",
        "+.5",
        "--to",
        "1E1",
        "--steps",
        "2e2",
    )
    assert [(one.seed, getattr(one, "starts", 0), getattr(one, "jobs", 0)) for one in seen] == [(10, 2, 3), (0, 0, 0)]
    assert (seen[1].start, seen[1].end, seen[1].steps) == (0.5, 10.0, 200)


def test_python_reads_words_as_the_command_line_does() -> None:
    assert get("wall-1d", N="2e1", m=" +1.5 ").N == 20
    assert get("wall-1d", N=20.0).N == 20
    for values in ({"N": "1_0"}, {"N": True}, {"m": True}, {"m": "１２"}, {"N": 10**30}):
        with pytest.raises(InputError, match=r"parameter [Nm] .* must be a (whole )?number"):
            get("wall-1d", **values)
    for setting in ({"factor": "1_0"}, {"homotopy_start": True}):
        with pytest.raises(InputError, match=r"setting \w+ must be a number"):
            workbench.solve("wall-1d", settings=setting)
    with pytest.raises(InputError, match=r"mu must be a number > 0 .*got True"):
        workbench.solve("wall-1d", "barrier", mu=True)
