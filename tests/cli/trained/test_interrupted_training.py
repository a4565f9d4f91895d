"""Killed and stopped training runs: the same command resumes them, with the same result as without a stop."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from distributed import Client, LocalCluster

from ocp import store

EAGER = "from ocp.store import checkpoint; checkpoint.SAVE_INTERVAL_S = 0.0"
"""Code that saves a checkpoint after every iteration, so that there is one soon."""
PROGRAM = [sys.executable, "-c", "import sys; from reports.cli.app import main; sys.exit(main())"]
ROOT = Path(__file__).parents[3]
LONG = [
    "train",
    "ball-throw",
    "-s",
    "samples=4",
    "-s",
    "rate=0.01",
    "-s",
    "evaluate_every=50",
    "-s",
    "hidden=4",
    "--iterations",
    "150",
    "--quiet",
]


def start(arguments: list[str], directory: Path) -> subprocess.Popen[str]:
    """Start ``ocp`` in another process; it and its workers import :data:`EAGER` as sitecustomize."""
    (directory / "first").mkdir(exist_ok=True)
    (directory / "first" / "sitecustomize.py").write_text(EAGER)
    return subprocess.Popen(
        [*PROGRAM, *arguments],
        cwd=directory,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": f"{directory / 'first'}:{ROOT}"},
        text=True,
    )


def finish(arguments: list[str], directory: Path) -> dict:
    done = start([*arguments, "--json"], directory)
    out, err = done.communicate(timeout=240)
    assert done.returncode == 0, err
    return json.loads(out) | {"err": err}


def wait_for(condition: Callable[[], object], seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def checkpoints(directory: Path) -> list[Path]:
    return list(directory.glob("runs/ball-throw/.unfinished-*/training.npz"))


def results(found: dict, directory: Path) -> list[xr.Dataset]:
    loaded = [store.load(directory / run["run"]).data for run in found["runs"]]
    return [data.drop_vars("wall_s") for data in loaded]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> list[xr.Dataset]:
    """Return the results of two seeds that ran without a stop."""
    directory = tmp_path_factory.mktemp("whole")
    found = finish([*LONG, "--seeds", "2", "--jobs", "1"], directory)
    assert not checkpoints(directory)
    return results(found, directory)


def assert_same(found: list[xr.Dataset], whole: list[xr.Dataset]) -> None:
    assert len(found) == len(whole)
    for one, other in zip(found, whole, strict=True):
        xr.testing.assert_identical(one, other)


@pytest.mark.costly
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_the_same_command_goes_on(tmp_path: Path, whole: list[xr.Dataset], how: int) -> None:
    process = start([*LONG, "--jobs", "1"], tmp_path)
    wait_for(lambda: checkpoints(tmp_path))
    process.send_signal(how)
    out, err = process.communicate(timeout=60)
    assert process.returncode == (-signal.SIGKILL if how == signal.SIGKILL else 130)
    if how == signal.SIGINT:
        assert "stopped by the user" in err and "Traceback" not in err
        assert "the same command resumes" in out
    assert store.list_runs(tmp_path / "runs") == []
    with np.load(checkpoints(tmp_path)[0]) as kept:
        done = len(kept["curve.wall_s"])
    assert 0 < done < 150
    found = finish([*LONG, "--jobs", "1"], tmp_path)
    assert_same(results(found, tmp_path), whole[:1])
    assert not checkpoints(tmp_path)


@pytest.mark.costly
def test_processes_killed_on_the_way_change_nothing(tmp_path: Path, whole: list[xr.Dataset]) -> None:
    process = start([*LONG, "--seeds", "2", "--jobs", "2", "--json"], tmp_path)
    wait_for(lambda: len(checkpoints(tmp_path)) == 2)
    os.kill(workers_of(process.pid)[-1], signal.SIGKILL)
    out, err = process.communicate(timeout=240)
    assert process.returncode == 0, err
    assert_same(results(json.loads(out), tmp_path), whole)


@pytest.mark.costly
def test_a_finished_seed_is_not_trained_again(tmp_path: Path, whole: list[xr.Dataset]) -> None:
    process = start([*LONG, "--seeds", "2", "--jobs", "1"], tmp_path)
    wait_for(lambda: list(tmp_path.glob("runs/ball-throw/.unfinished-*/point-*.json")))
    process.kill()
    process.communicate(timeout=60)
    first = store.list_runs(tmp_path / "runs")[0].path
    found = finish([*LONG, "--seeds", "2", "--jobs", "1"], tmp_path)
    assert "1 of 2 trainings already complete" in found["err"]
    assert Path(found["runs"][0]["run"]).resolve() == first.resolve()
    assert len(store.list_runs(tmp_path / "runs")) == 2
    assert_same(results(found, tmp_path), whole)


@pytest.fixture
def cluster() -> Iterator[LocalCluster]:
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as found:
        yield found


@pytest.mark.slow
def test_a_cluster_worker_killed_on_the_way_loses_nothing(
    tmp_path: Path, whole: list[xr.Dataset], cluster: LocalCluster
) -> None:
    with Client(cluster) as client:
        client.run(exec, EAGER)
    address = ["--scheduler", cluster.scheduler_address]
    process = start([*LONG, "--seeds", "2", *address, "--json"], tmp_path)
    wait_for(lambda: len(checkpoints(tmp_path)) == 2)
    os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)
    out, err = process.communicate(timeout=240)
    assert process.returncode == 0, err
    assert_same(results(json.loads(out), tmp_path), whole)


def workers_of(pid: int) -> list[int]:
    """Return the ids of the spawned worker processes, without the resource tracker."""
    found = map(int, Path(f"/proc/{pid}/task/{pid}/children").read_text().split())
    return [one for one in found if b"spawn_main" in Path(f"/proc/{one}/cmdline").read_bytes()]
