"""Jobs on a Dask cluster of two workers on this computer."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from distributed import LocalCluster

from ocp.errors import InputError
from ocp.jobs import cluster as over
from ocp.jobs.scheduling import Failure, run_jobs
from tests.unit.ocp.jobs.jobs_done import squared


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as found:
        yield found


def test_each_job_is_done_and_heard(cluster: LocalCluster) -> None:
    heard: list[tuple[int, Any]] = []
    jobs: list[dict[str, Any]] = [{"x": float(x), "wait": 0.05} for x in range(5)]
    jobs[3]["fails"] = True
    address = cluster.scheduler_address
    done = dict(run_jobs(squared, jobs, 1, address, lambda *news: heard.append(news)))
    assert [done[index]["square"][0] for index in (0, 1, 2, 4)] == [0.0, 1.0, 4.0, 16.0]
    assert isinstance(done[3], Failure) and str(done[3].error) == "x = 3.0 is refused"
    assert {(index, told["k"]) for index, told in heard} >= {(0, 0), (1, 0), (2, 0)}


@pytest.mark.costly
def test_a_worker_killed_on_the_way_loses_nothing(cluster: LocalCluster, tmp_path: Path) -> None:
    jobs: list[dict[str, Any]] = [{"x": float(x), "wait": 0.05} for x in range(4)]
    jobs[1]["dies"] = str(tmp_path / "once")
    done = dict(run_jobs(squared, jobs, 1, cluster.scheduler_address))
    assert [done[index]["square"][0] for index in range(4)] == [0.0, 1.0, 4.0, 9.0]
    assert (tmp_path / "once").read_text() == "++"


def test_jobs_end_when_the_caller_stops(cluster: LocalCluster, tmp_path: Path) -> None:
    mark = tmp_path / "mark"
    job = {"x": 1.0, "steps": 10**6, "wait": 0.02, "mark": str(mark)}

    def heard(*_: object) -> None:
        raise KeyboardInterrupt

    address = cluster.scheduler_address
    with pytest.raises(KeyboardInterrupt), closing(run_jobs(squared, [job], 1, address, heard)) as run:
        list(run)
    time.sleep(1.0)
    before = mark.stat().st_size
    time.sleep(0.5)
    assert mark.stat().st_size == before


def test_workers_that_lack_the_program(cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(over, "WORKER_IMPORT", "import only_here")
    with pytest.raises(InputError, match="lack this program: No module named 'only_here'"):
        list(run_jobs(squared, [{"x": 1.0}], 1, cluster.scheduler_address))


@pytest.mark.costly
def test_where_nobody_answers() -> None:
    with pytest.raises(InputError, match=r"no Dask scheduler answers at 'tcp://127.0.0.1:9'"):
        list(run_jobs(squared, [{"x": 1.0}], 1, "tcp://127.0.0.1:9"))
    with pytest.raises(InputError, match=r"no Dask scheduler answers at 'nonsense://'"):
        list(run_jobs(squared, [{"x": 1.0}], 1, "nonsense://"))


def test_where_dask_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"install centralpath\[cluster\]"):
        list(run_jobs(squared, [{"x": 1.0}], 1, "tcp://127.0.0.1:9"))


def test_where_there_are_no_workers() -> None:
    with (
        LocalCluster(n_workers=0, dashboard_address=":0") as empty,
        pytest.raises(InputError, match="has no workers; start some with dask worker"),
    ):
        list(run_jobs(squared, [{"x": 1.0}], 1, empty.scheduler_address))


@pytest.mark.costly_cases("inproc://1", "ucx://a:1", "tls://a:1")
@pytest.mark.parametrize("address", ["localhost", "tcp://[::1", "foo://a:1", "inproc://1", "ucx://a:1", "tls://a:1"])
def test_an_address_without_a_scheduler_is_refused_and_leaves_no_thread(address: str) -> None:
    before = set(threading.enumerate())
    with pytest.raises(InputError, match=r"no Dask scheduler answers at .*; start one"):
        list(run_jobs(squared, [{"x": 1.0}], 1, address))
    assert set(threading.enumerate()) <= before
