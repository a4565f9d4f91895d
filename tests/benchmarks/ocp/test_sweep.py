"""A sweep of 28 points on one core and on two, and with a worker killed meanwhile."""

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

from docs.generator.measured import write_table
from ocp import store
from tests.benchmarks.ocp.race import tell

WORDS = ["sweep", "push-disc", "--over", "M=0.5:2:7", "--over", "contact.mu=1e-4:1e-1:4:log", "--json", "--quiet"]
LONG, SHORT = 300, 20
"""Numbers of steps of points that take a second or two, and of points that take a tenth of one."""
FASTER = 1.7
ROUNDS = 2


def timed(out: Path, jobs: int, N: int, kill: bool = False) -> tuple[float, dict[str, Any]]:
    """Return the seconds of a whole command with ``jobs`` processes, and what it stored."""
    words = [*WORDS, "-p", f"N={N}", "--jobs", str(jobs), "--out", str(out)]
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
    """Compared is the wall time of the command with its start-up, the least of two alternating rounds.

    Short points are shown too: for them start-up of a second or two is most of the time.
    """
    seconds: dict[tuple[int, int], list[float]] = {}
    hashes: dict[int, set[str]] = {LONG: set(), SHORT: set()}
    for number in range(ROUNDS):
        for N, jobs in ((LONG, 1), (LONG, 2), (SHORT, 1), (SHORT, 2)):
            took, meta = timed(tmp_path / f"{N}-{jobs}-{number}", jobs, N)
            assert meta["points"] == 28
            hashes[N].add(meta["hash"])
            seconds.setdefault((N, jobs), []).append(took)
    killed, meta = timed(tmp_path / "killed", 2, LONG, kill=True)
    hashes[LONG].add(meta["hash"])
    assert [len(found) for found in hashes.values()] == [1, 1]
    least = {key: min(found) for key, found in seconds.items()}
    rows = [[f"N = {N}", f"{least[N, 1]:.1f}", f"{least[N, 2]:.1f}", f"{ratio(least, N):.2f}"] for N in (LONG, SHORT)]
    rows.append([f"N = {LONG}, one killed", "", f"{killed:.1f}", f"{least[LONG, 1] / killed:.2f}"])
    title = "A sweep of 28 points of push-disc, wall time of the whole command"
    columns = ["steps", "one process, s", "two, s", "ratio"]
    tell(title, columns, rows)
    write_table(
        "sweeps",
        title=title,
        command="pytest -m bench -s tests/benchmarks/ocp/test_sweep.py",
        columns=columns,
        rows=rows,
        note=f"Least of {ROUNDS} alternating runs. A process needs a second or two until its first"
        " point; all runs of one length stored the same data, to the last bit.",
    )
    assert ratio(least, LONG) >= FASTER


def ratio(least: dict[tuple[int, int], float], N: int) -> float:
    return least[N, 1] / least[N, 2]
