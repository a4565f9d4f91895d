"""A problem's file that is edited between two commands: results of both versions are never mixed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ocp import load, store
from ocp.errors import InputError
from ocp.jobs.sweep import sweep
from reports.cli import interrupt
from reports.cli.app import main

MINE = """
from dataclasses import replace
from problems.library import wall_1d
from problems.drawing import Circle
from weights import END

name, title, Params = "mine", "A mass and a wall of mine", wall_1d.Params

def build(params):
    problem = wall_1d.build(params)
    return replace(problem, name=name, terminal_cost=END * problem.terminal_cost)

def draw(params, state):
    return [Circle(float(state[0]), 0.0, 0.1)]
"""
QUICK = ["--reference", "none", "--quiet"]
ESTIMATE = ["estimate", "mine.py", "-p", "N=3", "-n", "400", "--estimators", "fobg,zobg", "--sweep", "m=1:2:3", *QUICK]
SWEEP = ["sweep", "mine.py", "-p", "N=3", "--contact", "exact", "--over", "m=1:2:3", "--quiet"]
SOLVE = ["solve", "mine.py", "-p", "N=3", "--contact", "exact", "--quiet"]
ANEW = "the problem's file, or what it imports, has changed since the first run: starting again"
Write = Callable[[int], None]


@pytest.fixture
def weigh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Write:
    """Return a function that writes the problem's file and the module with its weight."""
    monkeypatch.chdir(tmp_path)

    def write(end: int) -> None:
        Path("mine.py").write_text(MINE)
        Path("weights.py").write_text(f"END = {end}\n")

    write(1)
    return write


def stopped(line: list[str], monkeypatch: pytest.MonkeyPatch, root: str) -> None:
    """Run a command, and interrupt it as soon as a point is stored."""

    def check() -> None:
        if list(Path(root).glob("mine/.unfinished-*/point-*.json")):
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(interrupt, "raise_if_interrupted", check)
        assert main([*line, "--out", root]) == interrupt.EXIT_CODE
    assert kept(root) == 1


def kept(root: str) -> int:
    """Return the number of unfinished studies in a store."""
    return len(list(Path(root).glob("mine/.unfinished-*")))


def last(root: str, what: str) -> np.ndarray:
    """Return an array of the last run in a store."""
    return store.load(store.find_run("@last", root)).data[what].values


@pytest.mark.costly
@pytest.mark.parametrize("line", [ESTIMATE, SWEEP], ids=["estimate", "sweep"])
def test_a_study_goes_on_with_its_own_problem_only(
    weigh: Write, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], line
) -> None:
    what = {"estimate": "mean", "sweep": "cost"}[line[0]]
    for root in ("runs", "reverted"):
        stopped(line, monkeypatch, root)
    weigh(20)
    capsys.readouterr()
    for root in ("runs", "whole"):
        assert main([*line, "--out", root]) == 0
    assert capsys.readouterr().out.count(ANEW) == 1
    assert np.array_equal(last("runs", what), last("whole", what))
    weigh(1)
    assert main([*line, "--out", "reverted"]) == 0
    told = capsys.readouterr().out
    assert "resumed" in told and ANEW not in told
    assert not np.isclose(last("runs", what), last("reverted", what)).any()


@pytest.mark.costly
def test_a_file_that_changes_under_a_sweep_ends_it(weigh: Write) -> None:
    """A worker that starts after the change would build another problem."""
    costs = []
    for end in (1, 20):
        weigh(end)
        costs.append(sweep("mine.py", {"m": [1.0, 2.0]}, N=3, store="runs")["cost"].values)
    assert (costs[0] < costs[1]).all(), "the same process must read the file again"

    def edit(place: int, _: object) -> None:
        weigh(300)

    with pytest.raises(InputError, match="has changed since this was begun"):
        sweep("mine.py", {"m": [1.0, 2.0, 3.0]}, N=3, jobs=2, store="runs", progress=edit)


@pytest.mark.costly
def test_two_of_the_same_at_once_leave_each_other_alone(
    weigh: Write, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The second runs completely while the first is at its second point."""
    first, second = [*ESTIMATE, "--out", "runs", "--tag", "first"], [*ESTIMATE, "--out", "runs"]
    looks = iter(range(4))
    with monkeypatch.context() as patched:

        def check() -> None:
            if next(looks, 0) == 3:
                held = {path.name for path in Path("runs/mine").glob(".unfinished-*")}
                assert main(second) == 0
                assert {path.name for path in Path("runs/mine").glob(".unfinished-*")} == held
                assert list(Path("runs/mine").glob(".unfinished-*/point-00000.json"))

        patched.setattr(interrupt, "raise_if_interrupted", check)
        assert main(first) == 0
    assert "another process runs the same computation" in capsys.readouterr().out
    one, other = [entry.meta for entry in store.list_runs("runs")]
    assert one is not None and other is not None
    assert json.dumps(one["estimates"]) == json.dumps(other["estimates"])
    assert one["hash"] == other["hash"] and other["tags"] == ["first"]
    assert not list(Path("runs/mine").glob(".unfinished-*"))


@pytest.mark.costly
def test_commands_say_that_the_file_has_changed(weigh: Write, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(SOLVE) == 0
    lines = [
        "replay @last --source mine.py",
        "report @last --source mine.py -o a.pdf",
        "animate @last --source mine.py -o a.html",
        "export @last --source mine.py -o a.c",
        "solve mine.py -p N=3 --contact exact --quiet --from @last --out other",
    ]
    store_of = str(Path("runs").resolve())
    lines[-1] = lines[-1].replace("@last --out other", f"{store.find_run('@last', store_of)}")
    capsys.readouterr()
    for edited in (False, True):
        if edited:
            weigh(20)
        for line in lines:
            assert main(line.split()) == 0, line
            told = capsys.readouterr().out
            assert ("mine.py, or what it imports, has changed since" in told) == edited, line
        if not edited:
            # The last command has stored its own run, also of the unchanged file.
            assert load("@last", store="runs", source="mine.py").cost > 0
    with pytest.warns(UserWarning, match="has changed since"):
        load(store.list_runs("runs")[0].path, source="mine.py")


@pytest.mark.costly
def test_a_decision_is_of_this_problem_at_these_parameters(weigh: Write, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(SOLVE) == 0
    run = str(store.find_run("@last", "runs"))
    assert main(["solve", "wall-1d", "--contact", "barrier", "-p", "N=3", "--quiet"]) == 0
    other = str(store.find_run("@last", "runs"))
    estimate = ["estimate", "mine.py", "-n", "20", "--estimators", "zobg", *QUICK]
    capsys.readouterr()

    def told(*more: str) -> str:
        code = main([*estimate, *more])
        error = capsys.readouterr().err
        assert code == (2 if error else 0) and error.count("\n") == (code == 2), error
        return error

    assert told("-p", "N=3", "--at", run) == ""
    assert told("-p", "N=3", "--at", run, "--sweep", "m=1:2:2") == ""
    assert "the run is of wall-1d, not of mine" in told("-p", "N=3", "--at", other)
    assert "at other parameters; give those of the run: -p m=1.0" in told("-p", "N=3", "-p", "m=2", "--at", run)
    assert "at other parameters; give those of the run: -p N=3" in told("--at", run)
    weigh(20)
    assert "mine.py, or a file it imports, has changed since" in told("-p", "N=3", "--at", run)
