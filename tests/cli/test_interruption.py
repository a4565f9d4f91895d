"""Ctrl-C and kill: the program ends at once, keeps finished work, and leaves no incomplete run."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ocp import Status, store

PROGRAM = [sys.executable, "-c", "import sys; from reports.cli.app import main; sys.exit(main())"]
LONG_PATH = [
    "continue",
    "wall-1d",
    "--contact",
    "barrier",
    "--over",
    "contact.mu",
    "--from",
    "1",
    "--to",
    "1e-8",
    "--scale",
    "log",
    "--steps",
    "5000",
]
LONG_SOLVE = ["solve", "cart-walls", "--contact", "exact", "--starts", "9999"]


def start(arguments: list[str], directory: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*PROGRAM, *arguments],
        cwd=directory,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def read_lines(process: subprocess.Popen[str], count: int) -> list[str]:
    assert process.stderr is not None
    return [process.stderr.readline() for _ in range(count)]


def read_until(process: subprocess.Popen[str], words: str) -> None:
    assert process.stderr is not None
    for line in process.stderr:
        if words in line:
            return
    raise AssertionError(f"it ended without saying {words!r}")


@pytest.mark.costly
def test_ctrl_c_between_starts_keeps_the_best_of_them(tmp_path: Path) -> None:
    process = start([*LONG_SOLVE, "-v"], tmp_path)
    read_until(process, "active set")
    read_until(process, "t 0.")
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode in (3, 130)
    assert "Traceback" not in err
    (entry,) = store.list_runs(tmp_path / "runs")
    assert entry.meta is not None and str(entry.path.name) in out
    first_was_done = process.returncode == 130
    assert entry.meta["status"] == ("solved" if first_was_done else "interrupted")
    assert ("stopped by the user" in err) == first_was_done


@pytest.mark.costly
def test_ctrl_c_in_a_solver_keeps_the_best_point(tmp_path: Path) -> None:
    """The signal arrives during IPOPT, which would need seconds more."""
    process = start(["solve", "planar-hand", "--contact", "barrier", "-p", "N=60", "-vv", "--json"], tmp_path)
    read_until(process, "ipopt on planar-hand")
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 3, err
    found = json.loads(out)
    assert (found["status"], found["success"]) == ("interrupted", False)
    assert found["verdict"].startswith("Interrupted: cost ")
    assert "Traceback" not in err and "WARNING" not in err
    stored = store.load(tmp_path / found["run"])
    assert stored.status is Status.INTERRUPTED
    assert stored.meta["iterations"] > 0 and stored.meta["cost"] == found["cost"]
    assert stored.audit.dynamics_residual == found["dynamics_residual"], "it was audited"
    assert stored.data["x"].shape == stored.data["x_replay"].shape, "and replayed"
    listed = start(["runs", "--status", "interrupted", "--json"], tmp_path).communicate()[0]
    assert [run["run"] for run in json.loads(listed)["runs"]] == [found["run"]]


@pytest.mark.costly
def test_a_second_ctrl_c_ends_at_once(tmp_path: Path) -> None:
    process = start(["solve", "planar-hand", "--contact", "barrier", "-vv"], tmp_path)
    read_until(process, "ipopt on planar-hand")
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    read_until(process, "the best point is judged")
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    assert process.returncode == 130
    assert store.list_runs(tmp_path / "runs") == [], "nothing half written"


@pytest.mark.costly
def test_ctrl_c_keeps_the_points_of_a_path(tmp_path: Path) -> None:
    process = start([*LONG_PATH, "--json"], tmp_path)
    assert all(read_lines(process, 4)), "the heads, and three points"
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 130
    found = json.loads(out)
    assert len(found["points"]) >= 3
    assert found["success"] is False
    assert "stopped by the user" in found["verdict"]
    stored = store.load(tmp_path / found["run"])
    assert stored.meta["points"] == found["points"]
    assert stored.data.sizes["point"] == len(found["points"])


@pytest.mark.costly
@pytest.mark.parametrize("lines", [1, 5])
def test_kill_leaves_no_half_run(tmp_path: Path, lines: int) -> None:
    process = start(LONG_PATH, tmp_path)
    assert all(read_lines(process, lines))
    process.kill()
    process.communicate(timeout=60)
    assert process.returncode == -signal.SIGKILL
    assert store.list_runs(tmp_path / "runs") == []


def test_an_interrupt_that_compiled_code_swallowed_is_raised_again() -> None:
    from reports.cli import interrupt

    before = signal.getsignal(signal.SIGINT)
    with interrupt.watch_interrupts():
        interrupt.raise_if_interrupted()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            interrupt.raise_if_interrupted()
    assert signal.getsignal(signal.SIGINT) is before


WAVE = """import os, time
import numpy as np
theta = 0.7
def rollout(theta):
    if len(theta) > 10 and NAME == "slow" and "FAST" not in os.environ:
        time.sleep(60)
    return np.sin(theta)
"""


@pytest.mark.costly
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_ctrl_c_keeps_measured_simulators_and_the_same_command_resumes(
    tmp_path: Path, jobs: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("wave", "slow"):
        (tmp_path / f"{name}.py").write_text(f"NAME = {name!r}\n{WAVE}")
    command = ["gradients", "wave.py", "--world", "slow.py", "--jobs", jobs, "-n", "50"]
    process = start(command, tmp_path)
    read_until(process, "2 of 2: slow")
    for _ in range(600):
        if [*tmp_path.glob("runs/wave/.unfinished-*/point-00000.json")]:
            break
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130 and "1 of 2 measurements are kept" in out and "Traceback" not in err
    assert store.list_runs(tmp_path / "runs") == []
    monkeypatch.setenv("FAST", "1")
    out, err = start([*command, "--json"], tmp_path).communicate(timeout=120)
    assert "resumed; 1 of 2 measurements already complete" in err
    assert [row["verdict"] for row in json.loads(out)["worlds"]] == ["consistent", "consistent"]
    assert not [*tmp_path.glob("runs/wave/.unfinished-*")]
