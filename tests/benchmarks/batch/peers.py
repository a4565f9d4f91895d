"""Peers of the batch engine: CasADi's map and hand-written C.

CasADi runs every form of the rollout that it can evaluate, and the fastest one counts: which one
that is depends on the problem and the computer, and is measured by :func:`fastest`.
"""

from __future__ import annotations

import ctypes
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np

from dynamics.batch import open_loop
from dynamics.batch.engines.compiler import find_compiler
from dynamics.batch.graphs.inner import InnerLoop
from dynamics.batch.graphs.objective import Costs
from dynamics.batch.graphs.rollout_tapes import ClosedStep
from dynamics.contact import AffineStep, Step, interior_point
from dynamics.contact.interior_point import scalar_solution

_NEWTON = (4, 5, 6, 8, 12)
_LONGEST = 5000
"""Largest number of instructions of a flat graph whose C compiles within seconds."""
Inner = Callable[[InnerLoop, ca.MX, ca.MX], ca.MX]


def casadi_rollout(step: Step, stage: ca.Function, terminal: ca.Function, horizon: int) -> ca.Function:
    """Return (x0, U, before) -> (cost, gradient by U (nu, N)), unrolled and differentiated by CasADi.

    It is a flat SX graph of the closed form for one contact, and for several an MX loop over the
    step's explicit map, which follows the interior-point path.
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


def casadi_forms(step: Step, stage: ca.Function, terminal: ca.Function, horizon: int) -> dict[str, ca.Function]:
    """Return the forms of the rollout (x0, U, before) -> (cost, gradient) that CasADi can evaluate, by name.

    For one contact it is the closed form in a flat SX graph, for several Newton's method on the
    smoothed complementarity with a fixed number of iterations, in a flat SX graph or as MX calls, and
    for friction the path to its end. Each is differentiated by CasADi, or step by step backwards by
    the implicit function theorem, which needs fewer operations.
    """
    parts = step, stage, terminal, horizon
    forms = {"differentiated by CasADi": casadi_rollout(*parts)}
    affine = isinstance(step, AffineStep)
    if step.n == 1 and affine:
        forms["closed form, flat, own adjoint"] = _by_adjoint(ca.SX, *parts)
    elif affine:
        for count in _NEWTON:
            newton = _newton(count)
            forms[f"{count} Newton iterations, flat"] = _by_adjoint(ca.SX, *parts, newton)
            forms[f"{count} Newton iterations, calls"] = _by_adjoint(ca.MX, *parts, newton)
    else:
        forms["path, calls, own adjoint"] = _by_adjoint(ca.MX, *parts, _path)
    return forms


def _closed_form(step: Step) -> ca.Function:
    assert isinstance(step, AffineStep)
    x_next = step.a + step.B @ scalar_solution(step.z, step.F, step.mu)
    return ca.Function("closed", [step.system.x, step.system.u, step.p.vector], [x_next])


def _newton(count: int) -> Inner:
    def solve(loop: InnerLoop, guess: ca.MX, data: ca.MX) -> ca.MX:
        lam = guess
        for _ in range(count):
            lam = loop.newton(lam, data)[0]
        return loop.newton_solution(lam, data)

    return solve


def _path(loop: InnerLoop, guess: ca.MX, data: ca.MX) -> ca.MX:
    pair = interior_point.repeat_until_rest(loop.path)(ca.MX.ones(loop.n_pair), data)
    return loop.path_solution(pair, data)


def _by_adjoint(
    kind: type[ca.SX] | type[ca.MX],
    step: Step,
    stage: ca.Function,
    terminal: ca.Function,
    horizon: int,
    solve: Inner | None = None,
) -> ca.Function:
    """Return the rollout with its gradient from the steps' adjoints, in reverse order."""
    system = step.system
    tapes = ClosedStep(step, Costs(stage, terminal), open_loop(system.nx, system.nu)).tapes_with_adjoint
    p, still, loop = tapes.derived(step.p.values), ca.DM.zeros(system.nu), tapes.forward
    x0, before = kind.sym("x0", system.nx), kind.sym("before", system.nu)
    U = kind.sym("U", system.nu, horizon)
    x, cost, passed = ca.vertcat(x0, before) if tapes.n_carried else x0, kind(0), []
    for t in range(horizon):
        given = x, U[:, t], still, p
        if solve is None:
            moved, lam, local = loop(*given)
        else:
            moved, lam, local = loop.closing(*given, solve(loop, *loop.opening(*given)))
        passed.append((*given, lam))
        x, cost = moved, cost + local
    cost += tapes.terminal(x, p)
    bar, gradient = tapes.adjoint.terminal(x, p), []
    for arguments in reversed(passed):
        bar, part = tapes.adjoint.step(*arguments, bar)
        gradient.append(part)
    outputs = [cost, ca.horzcat(*reversed(gradient))]
    return ca.Function("rollout", [x0, U, before], outputs)


def generated(graph: ca.Function, folder: Path) -> ca.Function | None:
    """Return the compiled C that CasADi writes for the graph; None if it is too long."""
    if graph.is_a("SXFunction") and graph.n_instructions() > _LONGEST:
        return None
    folder.mkdir(parents=True)
    writer = ca.CodeGenerator("rollout.c")
    writer.add(graph)
    writer.generate(f"{folder}/")
    built = folder / "rollout.so"
    flags = ["-O3", "-march=native", "-shared", "-fPIC"]
    source = folder / "rollout.c"
    subprocess.run([find_compiler().path, *flags, "-o", built, source, "-lm"], check=True)
    return ca.external(graph.name(), str(built))


def fastest(forms: dict[str, ca.Function], x0: np.ndarray, before: np.ndarray, theta: np.ndarray) -> str:
    """Return the name of the correct form that takes the least processor time.

    A form is correct if it agrees with the one that CasADi differentiates to 1e-10 in cost and 1e-8
    of the largest entry of the gradient: too few Newton iterations do not.
    """
    taken: dict[str, float] = {}
    wanted: list[np.ndarray] = []
    for name, graph in forms.items():
        run = mapped(graph, x0, before, theta)
        cost, gradient = (np.array(value) for value in run())
        wanted = wanted or [cost, gradient]
        off = np.abs(gradient - wanted[1]).max() / np.abs(wanted[1]).max()
        if np.abs(cost / wanted[0] - 1).max() > 1e-10 or not off <= 1e-8:
            continue
        for _ in range(3):
            begin = time.process_time()
            run()
            seconds = time.process_time() - begin
            taken[name] = min(taken.get(name, seconds), seconds)
    return min(taken, key=lambda name: taken[name])


def mapped(graph: ca.Function, x0: np.ndarray, before: np.ndarray, theta: np.ndarray) -> Callable[[], list[ca.DM]]:
    """Return a call of `graph.map(n, "thread", 2)` on samples theta (n, N, nu)."""
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
    """Return a call of wall_peer.c, compiled with all options for speed."""
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
