"""Speed of rollouts with gradients, as ratios to alternatives."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from dynamics.batch import BatchFunction, Gaussian, RolloutFunction, open_loop
from dynamics.batch.engines import compiler
from dynamics.contact import Barrier, Step
from problems import get
from tests.benchmarks.batch.peers import casadi_forms, fastest, generated, hand_written, mapped
from tests.benchmarks.batch.race import Row, race, tell
from tests.unit.dynamics.batch.rollout_cases import closed, four_contact_matrices, four_contacts

pytestmark = pytest.mark.bench
MU = 1e-3


@dataclass(frozen=True)
class Case:
    """A rollout to time: its step and costs, its start, and the numbers of samples of the runners."""

    step: Step
    stage: ca.Function
    terminal: ca.Function
    horizon: int
    x0: np.ndarray
    u_before: np.ndarray | None
    n: int
    n_map: int

    def rollout(self, **options) -> RolloutFunction:
        """Return the rollout under test, with inputs as parameters."""
        system = self.step.system
        policy = open_loop(system.nx, system.nu)
        parts = (self.step, self.stage, self.terminal, self.horizon, policy)
        return RolloutFunction(*parts, **options)

    def inputs(self, n: int) -> np.ndarray:
        """Draw inputs (n, N, nu) around the input before."""
        rng = np.random.default_rng(0)
        around = 0.0 if self.u_before is None else self.u_before
        return around + 0.3 * rng.standard_normal((n, self.horizon, self.step.system.nu))

    def runner(self, f: RolloutFunction, theta: np.ndarray):
        """Return a call that overwrites its earlier result."""
        out = f(self.x0, theta, u_before=self.u_before)
        return lambda: f(self.x0, theta, u_before=self.u_before, out=out)


def of_problem(name: str, horizon: int, n: int, n_map: int) -> Case:
    problem = get(name)
    step = Barrier(mu=MU).close(problem.system)
    system, p = problem.system, step.p.vector
    names = [parameter.name for parameter in problem.parameters]
    physical = ca.vertcat(*[step.p[name] for name in names])
    du = ca.SX.sym("du", system.nu)
    stage, terminal = problem.cost_terms(system.x, system.u, du, system.lam, physical)
    change = [du] if problem.uses_du else []
    limits = problem.limits(problem.parameters.values)
    return Case(
        step=step,
        stage=ca.Function("stage", [system.x, system.u, *change, p], [stage]),
        terminal=ca.Function("terminal", [system.x, p], [terminal]),
        horizon=horizon,
        x0=np.array(limits[0])[:, 0],
        u_before=np.array(limits[1])[:, 0] if problem.uses_du else None,
        n=n,
        n_map=n_map,
    )


def wall() -> Case:
    return of_problem("wall-1d", 40, 1 << 17, 1 << 14)


def disc() -> Case:
    return of_problem("push-disc", 20, 1 << 16, 1 << 12)


def four() -> Case:
    step, stage, terminal = closed(four_contacts(), Barrier(mu=MU))
    return Case(step, stage, terminal, 20, np.full(6, 0.5), None, 1 << 13, 1 << 8)


def wall_parameters(case: Case) -> np.ndarray:
    """Return the parameters of wall-1d in the order of its peers in C and JAX."""
    values = {parameter.name: parameter.value for parameter in case.step.p}
    names = ("m", "h", "x0", "v0", "goal_x", "w_x", "w_v", "w_u", "w_end", "contact.mu")
    return np.array([values[name] for name in names])


def jax_cost(name: str) -> Callable:
    """Return the cost of a case in JAX as a function of the inputs (N, nu)."""
    from tests.benchmarks.batch import jax_peer

    case = CASES[name]()
    if name == "wall-1d":
        return jax_peer.wall(wall_parameters(case))
    return jax_peer.four_contacts(four_contact_matrices(), MU, case.x0)


CASES = {"wall-1d": wall, "four contacts": four, "push-disc": disc}


def casadi_peers(case: Case, theta: np.ndarray, folder: Path) -> dict[str, ca.Function]:
    """Return CasADi's fastest form on these samples, evaluated by CasADi and compiled from its C.

    Their keys name the forms.
    """
    before = np.zeros(case.step.system.nu) if case.u_before is None else case.u_before
    forms = casadi_forms(case.step, case.stage, case.terminal, case.horizon)
    own = fastest(forms, case.x0, before, theta)
    written = {name: generated(graph, folder / str(k)) for k, (name, graph) in enumerate(forms.items())}
    compiled = {name: graph for name, graph in written.items() if graph is not None}
    best = fastest(compiled, case.x0, before, theta)
    return {f"map ({own})": forms[own], f"map of its own C ({best})": compiled[best]}


@pytest.mark.parametrize("name", list(CASES))
def test_against_casadi(name, tmp_path):
    case = CASES[name]()
    theta = case.inputs(case.n)
    compiled = {f"c {k}": case.rollout(backend="c", threads=k) for k in (1, 2)}
    plain = case.rollout(backend="numpy", threads=2)
    before = np.zeros(case.step.system.nu) if case.u_before is None else case.u_before
    few = case.inputs(case.n_map)
    peers = {peer: mapped(graph, case.x0, before, few) for peer, graph in casadi_peers(case, few, tmp_path).items()}
    runners = {
        **peers,
        **{name: case.runner(f, theta) for name, f in compiled.items()},
        "numpy": case.runner(plain, theta),
    }
    seconds = race(runners)
    for run in peers.values():
        wanted = run()
        own = np.array(wanted[1]).T.reshape(few.shape)
        got = compiled["c 2"](case.x0, few, u_before=case.u_before)
        np.testing.assert_allclose(got.cost, np.array(wanted[0])[0], rtol=1e-10)
        np.testing.assert_allclose(got.gradient, own, rtol=1e-8, atol=1e-10 * np.abs(own).max())
    ours = seconds["c 2"].wall
    rows = [
        Row("c, two threads: rollouts with gradient", case.n / ours / 1e6, " M/s"),
        Row("c, two threads / one", seconds["c 1"].wall / ours, "x", least=1.8),
    ]
    for k, peer in enumerate(peers):
        slow = seconds[peer].processor / case.n_map
        rows.append(Row(f"CasADi {peer}", 1e-6 * case.n_map / seconds[peer].wall, " M/s"))
        for backend, key in (("c", "c 2"), ("numpy", "numpy")):
            ours = seconds[key].processor / case.n
            floor = 60.0 if backend != "numpy" else 4.0 if name == "wall-1d" else None
            rows.append(Row(f"{backend} / that", slow / ours, "x", least=None if k else floor))
    tell(f"{name}, {case.horizon} steps", rows)


def test_against_hand_written_c(tmp_path):
    case = wall()
    theta = case.inputs(case.n)
    p = wall_parameters(case)
    rows = []
    for threads in (1, 2):
        ours = case.runner(case.rollout(backend="c", threads=threads), theta)
        theirs = hand_written(tmp_path, p, theta, threads)
        cost, gradient = theirs()
        got = ours()
        np.testing.assert_allclose(got.cost, cost, rtol=1e-10)
        np.testing.assert_allclose(got.gradient, gradient, rtol=1e-8, atol=1e-9)
        seconds = race({"ours": ours, "hand": theirs}, rounds=15)
        ratio = seconds["hand"].wall / seconds["ours"].wall
        rows.append(Row(f"c / hand-written C, {threads} thread(s)", ratio, "x", 0.95))
    tell("wall-1d, 40 steps", rows)


@pytest.mark.parametrize("name", ["wall-1d", "four contacts"])
def test_against_jax(name):
    pytest.importorskip("jax", reason="JAX is not installed; it is only a peer to measure against")
    from tests.benchmarks.batch import jax_peer

    case = CASES[name]()
    theta = case.inputs(case.n)
    cost = jax_cost(name)
    runners = {f"jax {b}": jax_peer.blocked(cost, theta, b) for b in jax_peer.BLOCKS}
    costs = np.asarray(runners["jax 64"]()[0]).ravel()
    f = case.rollout(backend="c", threads=2)
    np.testing.assert_allclose(f(case.x0, theta).cost, costs, rtol=1e-7)
    seconds = race({"ours": case.runner(f, theta), **runners}, rounds=5)
    best = min(value.wall for key, value in seconds.items() if key != "ours")
    tell(name, [Row("C, two threads / best chunked JAX", best / seconds["ours"].wall, "x", 10.0)])


def test_fused_noise_and_moments():
    case = wall()
    f, noise, n = case.rollout(backend="c", threads=2), Gaussian(0.1, seed=0), 1 << 18
    theta, generator = case.inputs(1)[0], np.random.default_rng(0)
    drawn = np.empty(1 << 20)
    seconds = race(
        {
            "fused": lambda: f.moments(case.x0, theta, noise=noise, n_samples=n),
            "drawing": lambda: generator.standard_normal(out=drawn),
        }
    )
    cap = len(drawn) / seconds["drawing"].wall / case.horizon
    rate = n / seconds["fused"].wall
    own = seconds["drawing"].processor / len(drawn) * case.horizon
    rows = [
        Row("rollouts with noise, gradient and moments", rate / 1e6, " M/s"),
        Row("the same / what NumPy's generator would cap", rate / cap, "x", least=4.0),
        Row("by processor time, one core each", own * n / seconds["fused"].processor, "x"),
    ]
    tell("wall-1d, 40 steps, nothing stored", rows)


def test_memory_of_a_million_rollouts():
    program = (
        "import pathlib, re; from tests.benchmarks.batch.test_batch_speed import wall; "
        "from dynamics.batch import Gaussian; c = wall(); f = c.rollout(backend='c', threads=2); "
        "status = lambda: pathlib.Path('/proc/self/status').read_text(); "
        "peak = lambda: int(re.search(r'VmHWM:\\s+(\\d+)', status())[1]) / 1024; "
        "before = peak(); "
        "f.moments(c.x0, c.inputs(1)[0], noise=Gaussian(0.1, 0), n_samples=1_000_000, score=True); "
        "print(before, peak())"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    before, peak = (float(word) for word in done.stdout.split())
    tell(
        "wall-1d, a million rollouts with gradient moments",
        [
            Row("peak of the process", peak, " MB", most=300.0),
            Row("of that, the run itself", peak - before, " MB"),
        ],
    )


def processor_seconds() -> float:
    """Return processor seconds of this process and of those that it waited for, such as a compiler."""
    return sum(os.times()[:4])


def test_compile_time(tmp_path, monkeypatch):
    rows = []
    for name, make in CASES.items():
        for horizon in (10, 1000):
            monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / f"{name}-{horizon}"))
            monkeypatch.setattr(compiler, "_loaded", {})
            case = make()
            object.__setattr__(case, "horizon", horizon)
            begin = processor_seconds()
            case.rollout(backend="c")
            seconds = processor_seconds() - begin
            rows.append(Row(f"c, {name}, {horizon} steps", seconds, " s", most=1.0))
    tell("graphs, source and compiler together, whatever the horizon", rows)


def test_flat_function_of_the_unrolled_graph(tmp_path):
    case = wall()
    n = 1 << 14
    theta, before = case.inputs(n), np.zeros(1)
    rows = theta.reshape(n, -1)
    peers = casadi_peers(case, theta[:1024], tmp_path)
    graph = next(iter(peers.values()))
    runners = {peer: mapped(form, case.x0, before, theta) for peer, form in peers.items()}
    f = BatchFunction(graph, backend="c", threads=2)
    out = f(case.x0, rows, before)
    runners["c"] = functools.partial(f, case.x0, rows, before, out=out)
    seconds = race(runners)
    tell(
        "wall-1d unrolled",
        [
            Row(
                f"c / CasADi {peer}",
                seconds[peer].processor / seconds["c"].processor,
                "x",
                least=None if k else 30.0,
            )
            for k, peer in enumerate(peers)
        ],
    )
