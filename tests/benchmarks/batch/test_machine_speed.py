"""Rollouts with gradients through frictional contact: hopper and half-cheetah against CasADi."""

from __future__ import annotations

import time

import numpy as np
import pytest

from tests.benchmarks.batch.peers import mapped
from tests.benchmarks.batch.race import Row, race, tell
from tests.benchmarks.batch.test_batch_speed import casadi_peers, of_problem

pytestmark = pytest.mark.bench
HORIZON = 20


@pytest.mark.parametrize("name", ["hopper", "half-cheetah"])
def test_machines_against_casadi(name, monkeypatch, tmp_path):
    case = of_problem(name, HORIZON, 1 << 10, 1 << 4)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    began = time.perf_counter()
    two = case.rollout(backend="c", threads=2)
    first = time.perf_counter() - began
    began = time.perf_counter()
    case.rollout(backend="c", threads=2)
    again = time.perf_counter() - began
    rng = np.random.default_rng(0)
    theta = 0.02 * rng.standard_normal((case.n, HORIZON, case.step.system.nu))
    few = theta[: case.n_map]
    before = np.zeros(case.step.system.nu)
    peers = {
        peer: mapped(graph, case.x0, before, few)
        for peer, graph in casadi_peers(case, few, tmp_path).items()
    }
    seconds = race({**peers, "two": case.runner(two, theta)})
    got = two(case.x0, few)
    rows = [
        Row("C, two threads: rollouts with gradient", case.n / seconds["two"].wall / 1e3, " k/s")
    ]
    for k, (peer, run) in enumerate(peers.items()):
        np.testing.assert_allclose(got.cost, np.array(run()[0])[0], rtol=1e-9)
        slow, ours = (seconds[peer].processor / case.n_map, seconds["two"].processor / case.n)
        rows.append(Row(f"C / CasADi {peer}", slow / ours, "x", least=None if k else 30.0))
    rows += [Row("compile", first, " s", most=60.0), Row("cached", again, " s")]
    tell(f"{name}, H = {HORIZON}", rows)
