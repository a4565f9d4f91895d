"""Ctrl-C and kill: the program ends at once, keeps what is finished, and leaves no half run."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from ocp import store

PROGRAM = [sys.executable, "-c", "import sys; from reports.cli.app import main; sys.exit(main())"]
LONG_PATH = [
    "continue", "wall-1d", "--over", "contact.mu", "--from", "1", "--to", "1e-8",
    "--scale", "log", "--steps", "5000",
]  # fmt: skip
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


def test_ctrl_c_ends_a_solve(tmp_path: Path) -> None:
    process = start(LONG_SOLVE, tmp_path)
    assert all(read_lines(process, 3))
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "stopped by the user" in err and "Traceback" not in err
    assert not [entry for entry in store.list_runs(tmp_path / "runs") if entry.damage]


def test_ctrl_c_keeps_the_points_of_a_path(tmp_path: Path) -> None:
    process = start([*LONG_PATH, "--json"], tmp_path)
    assert all(read_lines(process, 3))
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
    with interrupt.watched():
        interrupt.check()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            interrupt.check()
    assert signal.getsignal(signal.SIGINT) is before
