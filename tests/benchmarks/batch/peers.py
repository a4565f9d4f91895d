"""What the batch engine is measured against: CasADi's map and hand-written C."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np

from dynamics.batch.compiler import find_compiler
from dynamics.contact import Step
from dynamics.contact.interior_point import scalar_solution


def casadi_rollout(
    step: Step, stage: ca.Function, terminal: ca.Function, horizon: int
) -> ca.Function:
    """(x0, U, before) to cost and gradient by U (nu, N), unrolled.

    For one contact a flat SX graph of the closed form, which is CasADi's fastest; for several an MX
    loop over the step's explicit map.
    """
    kind = ca.SX if step.n == 1 else ca.MX
    system, values = step.system, step.p.values
    x0, before = kind.sym("x0", system.nx), kind.sym("before", system.nu)
    U = kind.sym("U", system.nu, horizon)
    advance = _closed_form(step) if step.n == 1 else step.map
    x, last, cost = x0, before, kind(0)
    for t in range(horizon):
        u = U[:, t]
        cost += stage(x, u, u - last, values) if stage.n_in() == 4 else stage(x, u, values)
        moved = advance(x, u, values)
        x, last = moved[0] if isinstance(moved, (tuple, list)) else moved, u
    cost += terminal(x, values)
    return ca.Function("rollout", [x0, U, before], [cost, ca.gradient(cost, U)])


def _closed_form(step: Step) -> ca.Function:
    x_next = step.a + step.B @ scalar_solution(step.z, step.F, step.mu)
    return ca.Function("closed", [step.system.x, step.system.u, step.p.vector], [x_next])


def mapped(
    graph: ca.Function, x0: np.ndarray, before: np.ndarray, theta: np.ndarray
) -> Callable[[], list[ca.DM]]:
    """A call of `graph.map(n, "thread", 2)` on samples theta (n, N, nu)."""
    n, horizon, nu = theta.shape
    fn = graph.map(n, "thread", 2)
    arguments = [
        ca.repmat(ca.DM(x0), 1, n),
        ca.DM(theta.reshape(n * horizon, nu).T),
        ca.repmat(ca.DM(before), 1, n),
    ]
    return lambda: fn.call(arguments)


def hand_written(
    folder: Path, p: np.ndarray, theta: np.ndarray, threads: int
) -> Callable[[], tuple[np.ndarray, np.ndarray]]:
    """A call of wall_peer.c, compiled with everything that speed could ask for."""
    n, horizon = theta.shape[:2]
    built = folder / "wall_peer.so"
    source = Path(__file__).with_name("wall_peer.c")
    flags = ["-O3", "-march=native", "-ffast-math", "-fopenmp", "-shared", "-fPIC"]
    subprocess.run([find_compiler().path, *flags, "-o", built, source, "-lm"], check=True)
    wall = ctypes.CDLL(str(built)).wall
    pointer = ctypes.c_void_p
    wall.argtypes = [*2 * [ctypes.c_long], *4 * [pointer], ctypes.c_int]
    cost, gradient = np.empty(n), np.empty(theta.shape)
    addresses = [a.ctypes.data for a in (p, theta, cost, gradient)]

    def call() -> tuple[np.ndarray, np.ndarray]:
        wall(n, horizon, *addresses, threads)
        return cost, gradient

    return call
