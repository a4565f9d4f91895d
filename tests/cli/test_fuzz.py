"""Thousands of random command lines, run in this process, each end in a result or in one sentence."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import pairwise

import pytest
from hypothesis import HealthCheck, given, settings

from reports.cli import app
from reports.cli.app import main
from tests.cli.command_lines import OBJECTIVES, lines

MOST_S = 2.0
"""Maximum processor time [s] of a command that does not solve anything."""
QUIETLY = {
    "derandomize": True,
    "deadline": None,
    "database": None,
    "suppress_health_check": list(HealthCheck),
}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Return a mapping from placeholder to a stored solve, continuation or training, or to data."""
    root = tmp_path_factory.mktemp("store")
    short = ["wall-1d", "-p", "N=4", "--quiet"]
    path = ["--over", "contact.mu", "--from", "1e-1", "--to", "1e-2", "--steps", "2"]
    assert main(["solve", *short, "--out", str(root / "a")]) == 0
    assert main(["continue", *short, *path, "--out", str(root / "b")]) == 0
    small = ["-s", "samples=2", "-p", "horizon=3", "--iterations", "1", "--quiet"]
    assert main(["train", "ball-throw", *small, "--out", str(root / "c")]) == 0
    data = root / "data.nc"
    assert main(["collect", "push-1d", "--samples", "100", "-o", str(data), "--quiet"]) == 0
    # This loads JAX, which takes longer than a checked command may.
    network = ["learn", str(data), "--model", "mlp", "--hidden", "2", "--epochs", "1"]
    assert main([*network, "-o", str(root / "model.nc"), "--quiet"]) == 0
    stored = {
        f"@{kind}": str(next((root / at).glob("*/2*")))
        for kind, at in (("solve", "a"), ("continue", "b"), ("train", "c"))
    }
    return {**stored, "@data": str(data)}


@pytest.fixture
def judged(runs, tmp_path, monkeypatch, capsys) -> Callable[[list[str]], int]:
    """Return a function that runs a command line in an empty directory and checks how it ended."""
    monkeypatch.chdir(tmp_path)

    def judge(line: list[str], most: float = MOST_S) -> int:
        words = [runs.get(word, word) for word in line]
        capsys.readouterr()
        began = time.process_time()
        code = main(words)
        took = time.process_time() - began
        out, err = capsys.readouterr()
        assert code in (0, 2, 3, 4), err
        assert "Traceback" not in err and "internal error" not in err
        if code == 2:
            assert out == ""
            assert err.startswith("error: ") and err.count("\n") == 1, err
            assert len(err) < 1200, err
        if code == 0 and "--help" not in words:
            assert not idle(line), f"{idle(line)} had no effect"
        assert took < most, f"{took:.1f} s"
        return code

    return judge


def idle(line: list[str]) -> str:
    """Return an option in a command line that can have no effect, or an empty text, from its words alone."""
    words = dict(pairwise(line))
    settings = {
        f"{flag} {value.partition('=')[0].strip()}": value.partition("=")[2].strip()
        for flag, value in pairwise(line)
        if flag in ("-s", "-c", "-p")
    }
    for flag in ("--contact", "--policy", "--out", "--seed", "-n", "--sweep", "--json", "--fps"):
        if line.count(flag) > 1 and "--pdf" not in line:
            return f"{flag} given twice"
    if line[0] in ("solve", "continue"):
        return _idle_in_a_solve(words, settings)
    return _idle_in_an_estimate(line, words, settings) if line[0] == "estimate" else ""


def _idle_in_a_solve(words: dict[str, str], settings: dict[str, str]) -> str:
    exact = words.get("--contact") == "exact" or settings.get("-c base") == "exact"
    direct = words.get("--method", "direct") == "direct"
    if "--rank" in words and words.get("--starts", "1") == "1":
        return "--rank of one start"
    if "-s strategy" in settings and not (direct and words.get("--contact") != "barrier"):
        return "-s strategy"
    for name in ("-s homotopy", "-s factor", "-s homotopy_start"):
        if name in settings and exact and (direct or name != "-s homotopy"):
            return name
    if settings.get("-s homotopy") == "false" and {"-s factor", "-s homotopy_start"} & settings.keys():
        return "-s factor or start without a homotopy"
    over = words.get("--over", "")
    taken = {f"-c {over.removeprefix('contact.')}", f"-p {over}"} & settings.keys()
    return f"{taken} of what is continued over" if "--over" in words and taken else ""


def _idle_in_an_estimate(line: list[str], words: dict[str, str], settings: dict[str, str]) -> str:
    if line[1] in OBJECTIVES:
        for flag in ("--contact", "-c", "--policy", "--at"):
            if flag in line[2:] and "--pdf" not in line:
                return flag
    if words.get("--reference") in ("none", "closed-form") and "--reference-samples" in words:
        return "--reference-samples"
    if "-s alpha.gamma" in settings and "alpha" not in words.get("--estimators", "alpha"):
        return "-s alpha.gamma"
    swept = words.get("--sweep", "").partition("=")[0]
    flag = {"sigma": "--sigma", "samples": "-n"}.get(swept, f"-p {swept}")
    return flag if swept and (flag in words or flag in settings) else ""


def stub(*_: object) -> int:
    """Return exit code 0; replaces the work of a command, after its input was checked."""
    return 0


@pytest.mark.costly
@settings(max_examples=200, **QUIETLY)
@given(line=lines())
def test_two_hundred_command_lines(line: list[str], judged, monkeypatch) -> None:
    monkeypatch.setattr(app, "run_checked", stub)
    judged(line)


@pytest.mark.slow
@settings(max_examples=10_000, **QUIETLY)
@given(line=lines())
def test_ten_thousand_command_lines(line: list[str], judged, monkeypatch) -> None:
    monkeypatch.setattr(app, "run_checked", stub)
    judged(line)


@pytest.mark.slow
@settings(max_examples=50, **QUIETLY)
@given(line=lines(("solve", "estimate", "replay", "report", "show", "runs", "export")))
def test_fifty_command_lines_that_are_carried_out(line: list[str], judged) -> None:
    if line[0] in ("solve", "estimate"):
        line = [line[0], "wall-1d", *line[2:]]
    judged(line, most=60.0)
