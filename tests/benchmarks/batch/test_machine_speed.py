"""Speed of rollouts with frictional contact: hopper and half-cheetah against CasADi and MuJoCo."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dynamics.batch import RolloutFunction, open_loop
from dynamics.batch.graphs import rollout_tapes
from dynamics.contact import Barrier, starts
from dynamics.contact.path import Path
from problems.bodies.half_cheetah.machine import half_cheetah
from problems.bodies.hopper.machine import hopper
from problems.bodies.simulation import simulation
from tests.benchmarks.batch import mujoco_peer
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
    peers = {peer: mapped(graph, case.x0, before, few) for peer, graph in casadi_peers(case, few, tmp_path).items()}
    seconds = race({**peers, "two": case.runner(two, theta)})
    got = two(case.x0, few)
    rows = [Row("C, two threads: rollouts with gradient", case.n / seconds["two"].wall / 1e3, " k/s")]
    for k, (peer, run) in enumerate(peers.items()):
        np.testing.assert_allclose(got.cost, np.array(run()[0])[0], rtol=1e-9)
        slow, ours = (seconds[peer].processor / case.n_map, seconds["two"].processor / case.n)
        rows.append(Row(f"C / CasADi {peer}", slow / ours, "x", least=None if k else 30.0))
    rows += [Row("compile", first, " s", most=60.0), Row("cached", again, " s")]
    tell(f"{name}, H = {HORIZON}", rows)


def let_loose(name: str, threads: int) -> tuple[RolloutFunction, np.ndarray]:
    """Return rollouts of a machine with all its spheres, and the state of its environment's reset."""
    problem, x0 = simulation(name)
    step, system = Barrier(mu=1e-3).close(problem.system), problem.system
    p, policy = step.p.vector, open_loop(system.nx, system.nu)
    stage = ca.Function("stage", [system.x, system.u, p], [0.1 * ca.sumsqr(system.u)])
    end = ca.Function("end", [system.x, p], [-system.x[0]])
    return RolloutFunction(step, stage, end, HORIZON, policy, backend="c", threads=threads), x0


def from_ones(path: Path) -> ca.Function:
    """Return a warm start that ignores the step before and is the cold one."""
    lam = ca.SX.sym("lam", path.n)
    return ca.Function("warm", [lam, path.data], [ca.SX.ones(path.size)])


def runner(f: RolloutFunction, x0: np.ndarray, theta: np.ndarray, **options: Any) -> Callable:
    out = f(x0, theta, **options)
    return lambda: f(x0, theta, out=out, **options)


@pytest.mark.parametrize("name", ["hopper", "half-cheetah"])
def test_the_contact_solve_of_a_rollout(name, monkeypatch, tmp_path):
    """It is compared with a start from ones at every step, and with this and the matrix of all pairs.

    The latter is how rollouts were before their solve used coordinates and warm starts. A rollout
    without gradient saves only the backward sweep, which is the smaller part: a step's solve takes
    about eight iterations, each as long as the adjoint of the step.
    """
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    began = time.perf_counter()
    f, x0 = let_loose(name, 1)
    f(x0, np.zeros((HORIZON, f.tapes.nu)))
    compiled = time.perf_counter() - began
    with monkeypatch.context() as patched:
        patched.setattr(starts, "warm_start", from_ones)
        cold, _ = let_loose(name, 1)
        patched.setattr(rollout_tapes, "path_of", Path.of_system)
        before, _ = let_loose(name, 1)
    theta = 0.1 * np.random.default_rng(0).standard_normal((1024, HORIZON, f.tapes.nu))
    batches = [runner(f, x0, few) for few in np.split(theta, len(theta) // 16)]
    seconds = race(
        {
            "warm": runner(f, x0, theta),
            "forward": runner(f, x0, theta, gradient=False),
            "few": lambda: [run() for run in batches],
            "cold": runner(cold, x0, theta),
            "before": runner(before, x0, theta[:256]),
        }
    )
    # A step of violent motion may have several solutions, and starts may find different ones.
    apart = np.abs(f(x0, theta).cost / cold(x0, theta).cost - 1) > 1e-7
    assert apart.mean() < 0.01
    each = {key: seconds[key].processor / len(theta) for key in seconds}
    each["before"] *= 4
    ours = each["warm"]
    tell(
        f"{name}, H = {HORIZON}, one thread",
        [
            Row("rollouts with gradient", 1e-3 / ours, " k/s"),
            Row("all pairs, from ones / that", each["before"] / ours, "x", least=1.8),
            Row("from ones / that", each["cold"] / ours, "x", least=1.2),
            Row("batches of 16: of that rate", ours / each["few"], "x", least=0.6),
            Row("without gradient: of that rate", ours / each["forward"], "x"),
            Row("compile", compiled, " s", most=60.0),
        ],
    )


@pytest.mark.parametrize("name", ["hopper", "half-cheetah"])
def test_machines_against_mujoco(name):
    mujoco = pytest.importorskip("mujoco")
    machine = hopper() if name == "hopper" else half_cheetah()
    model = mujoco.MjModel.from_xml_string(mujoco_peer.mjcf(machine))
    f, x0 = let_loose(name, 2)
    theta = 0.1 * np.random.default_rng(0).standard_normal((2048, HORIZON, f.tapes.nu))
    start, some, few = x0[: 2 * model.nq], theta[:512], theta[:32]
    seconds = race(
        {
            "ours": runner(f, x0, theta),
            "forward": runner(f, x0, theta, gradient=False),
            "rollout": mujoco_peer.forward(model, start, some, 2),
            "transitionFD": mujoco_peer.derivatives(model, start, few, 2),
        }
    )
    sizes = {"ours": 2048, "forward": 2048, "rollout": 512, "transitionFD": 32}
    each = {key: seconds[key].processor / size for key, size in sizes.items()}
    tell(
        f"{name}, H = {HORIZON}, h = {machine.h}, against MuJoCo {mujoco.__version__}",
        [
            Row("MuJoCo: rollouts", 1e-3 / each["rollout"], " k/s of a processor"),
            Row("MuJoCo: with derivatives", 1e-3 / each["transitionFD"], " k/s of a processor"),
            Row("C / mujoco.rollout", each["rollout"] / each["forward"], "x"),
            Row("C / mjd_transitionFD", each["transitionFD"] / each["ours"], "x", least=5.0),
        ],
    )
