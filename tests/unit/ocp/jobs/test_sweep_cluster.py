"""A sweep on a Dask cluster of two workers, one of which is killed during the sweep."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest
from distributed import LocalCluster

from ocp.jobs.sweep import sweep
from tests.unit.ocp.jobs.same import same


@pytest.fixture
def cluster() -> Iterator[LocalCluster]:
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as found:
        yield found


@pytest.mark.slow
def test_a_cluster_that_loses_a_worker_gives_the_same_data(cluster: LocalCluster) -> None:
    over, short = {"M": [0.5, 1.0, 2.0], "contact.mu": [1e-3, 1e-2]}, {"N": 6}
    killed: list[int] = []

    def kill_one(*_: object) -> None:
        if not killed:
            killed.append(next(iter(cluster.workers.values())).process.pid)
            os.kill(killed[0], signal.SIGKILL)

    address = cluster.scheduler_address
    beside = sweep("push-1d", over, "barrier", params=short, scheduler=address, progress=kill_one)
    assert killed
    assert same(beside, sweep("push-1d", over, "barrier", params=short))
