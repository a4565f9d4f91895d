"""A sweep of 28 points on one core and on two, and with a worker killed on the way."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from ocp import store
from tests.benchmarks.ocp.race import tell

WORDS = ["sweep", "push-disc", "-p", "N=150", "--over", "M=0.5:2:7", "--over",
         "contact.mu=1e-4:1e-1:4:log", "--json", "--quiet"]  # fmt: skip
FASTER = 1.7
ROUNDS = 2


def timed(out: Path, jobs: int, kill: bool = False) -> tuple[float, dict[str, Any]]:
    """Seconds of a whole command, on as many cores, and what it stored."""
    words = [*WORDS, "--jobs", str(jobs), "--out", str(out)]
    code = f"import sys\nfrom reports.cli.app import main\nsys.exit(main({words!r}))"
    one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    began = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=os.environ | one_thread
    )
    if kill:
        while not [*out.glob("*/.unfinished-*/point-*.json")]:
            time.sleep(0.05)
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        os.kill(int(children[-1]), signal.SIGKILL)
    told, _ = process.communicate()
    assert process.returncode == 0
    return time.monotonic() - began, store.read_meta(Path(json.loads(told)["run"]))


@pytest.mark.bench
def test_a_sweep_on_two_cores_against_one(tmp_path: Path) -> None:
    """Wall time of the command with everything in it, alternately, least of two rounds."""
    seconds: dict[int, list[float]] = {1: [], 2: []}
    hashes = set()
    for number in range(ROUNDS):
        for jobs, spent in seconds.items():
            took, meta = timed(tmp_path / f"{jobs}-{number}", jobs)
            assert meta["points"] == 28
            hashes.add(meta["hash"])
            spent.append(took)
    killed, meta = timed(tmp_path / "killed", 2, kill=True)
    hashes.add(meta["hash"])
    assert len(hashes) == 1
    one, two = min(seconds[1]), min(seconds[2])
    rows = [["1", f"{one:.1f}", "1.00"], ["2", f"{two:.1f}", f"{one / two:.2f}"],
            ["2, one killed", f"{killed:.1f}", f"{one / killed:.2f}"]]  # fmt: skip
    tell("28 points, wall time", ["processes", "s", "ratio"], rows)
    assert one / two >= FASTER
