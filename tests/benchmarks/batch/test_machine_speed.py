"""Rollouts with gradients through frictional contact: hopper and half-cheetah against CasADi."""

from __future__ import annotations

import time

import numpy as np
import pytest

from tests.benchmarks.batch.peers import casadi_rollout, mapped
from tests.benchmarks.batch.race import race, tell
from tests.benchmarks.batch.test_batch_speed import of_problem

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
    graph = casadi_rollout(case.step, case.stage, case.terminal, HORIZON)
    before = np.zeros(case.step.system.nu)
    runners = {"map": mapped(graph, case.x0, before, few), "two": case.runner(two, theta)}
    seconds = race(runners)
    wanted, got = runners["map"](), two(case.x0, few)
    np.testing.assert_allclose(got.cost, np.array(wanted[0])[0], rtol=1e-9)
    rate, base = case.n / seconds["two"], case.n_map / seconds["map"]
    rows = [
        ("C, two threads: rollouts with gradient", rate / 1e3, " k/s", None),
        ("C / CasADi map on two threads", rate / base, "x", 30.0),
        ("compile, at most 60 s", first, " s", None),
        ("cached", again, " s", None),
    ]
    tell(f"{name}, H = {HORIZON}", rows)
