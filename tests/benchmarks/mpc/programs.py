"""Solve one sample's quadratic program by the controller's method, by PIQP and by CasADi's plugins."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

import casadi as ca
import numpy as np
import piqp
import scipy.sparse as sp

import problems
from docs.generator.measured import table, write_table
from ocp.mpc.controller import Controller
from ocp.mpc.horizon_qp import MAX_QP_ITERATIONS, PENALTY_CURVATURE, HorizonQP, Tolerance
from ocp.mpc.linearised import Affine, Linearised
from ocp.mpc.plants import Plant
from tests.benchmarks.mpc.compiled_program import compiled_qp

CASES = (
    ("soft-walls", 5),
    ("soft-walls", 10),
    ("soft-walls", 20),
    ("soft-walls", 50),
    ("spinner", 5),
    ("spinner", 10),
    ("spinner", 20),
    ("spinner", 40),
    ("spinner", 50),
)
SAMPLE, ROUNDS, SAME, LIMIT = 5, 15, 1e-6, 2.0
"""Sample of the program; solves; largest difference; limit [s] of all solves."""
PLUGINS: dict[str, dict[str, Any]] = {
    "piqp": {},
    "proxqp": {"proxqp": {"eps_abs": 1e-9, "eps_rel": 0.0, "max_iter": 10000}},
    "osqp": {"osqp": {"eps_abs": 1e-8, "eps_rel": 0.0, "max_iter": 20000, "verbose": False, "polish": True}},
    "qpoases": {"printLevel": "none", "sparse": True},
    "daqp": {},
    "highs": {"highs": {"output_flag": False}},
}


@dataclass(frozen=True)
class Program:
    """The program ``min 1/2 x'Px + c'x``, ``A x = b``, ``G x >= low``, ``x_l <= x <= x_u``."""

    P: sp.csc_matrix
    c: np.ndarray
    A: sp.csc_matrix
    b: np.ndarray
    G: sp.csc_matrix
    low: np.ndarray
    x_l: np.ndarray
    x_u: np.ndarray

    @classmethod
    def of(
        cls, lin: Linearised, rows: Affine, dx0: np.ndarray, bounds: tuple[np.ndarray, np.ndarray], penalty: float
    ) -> Program:
        """Assemble the program of :class:`~ocp.mpc.horizon_qp.HorizonQP` with one slack a step, in costs of 1.

        The variables are (du_k, s_k, dx_{k+1}) of all steps k.
        """
        (N, nx), m, nu = lin.x_next.value.shape, rows.value.shape[1], bounds[0].shape[1]
        each = nu + 1 + nx
        size = N * each
        P, c, A, G = np.zeros((size, size)), np.zeros(size), np.zeros((N * nx, size)), np.zeros((N * m, size))
        # Columns of w = (dx, du before, du) as linear functions of the variables, and of the fixed start.
        for k in range(N):
            w, fixed = np.zeros((nx + 2 * nu, size)), np.zeros(nx + 2 * nu)
            inputs = np.arange(k * each, k * each + nu)
            w[nx + nu :, inputs] = np.eye(nu)
            if k:
                w[:nx, inputs[0] - nx : inputs[0]] = np.eye(nx)
                w[nx : nx + nu, inputs - each] = np.eye(nu)
            else:
                fixed[:nx] = dx0
            P += w.T @ lin.hessian[k] @ w
            c += w.T @ (lin.gradient[k] + lin.hessian[k] @ fixed)
            slack, x_next = inputs[-1] + 1, slice(inputs[-1] + 2, inputs[-1] + 2 + nx)
            P[slack, slack], c[slack] = PENALTY_CURVATURE * penalty, penalty
            equations, numbers = slice(k * nx, (k + 1) * nx), slice(k * m, (k + 1) * m)
            A[equations] = -lin.x_next.by_x[k] @ w[:nx] - lin.x_next.by_u[k] @ w[nx + nu :]
            A[equations, x_next] = np.eye(nx)
            G[numbers] = rows.by_x[k] @ w[:nx] + rows.by_u[k] @ w[nx + nu :]
            G[numbers, slack] = 1.0
        P[-nx:, -nx:] += lin.end[1]
        c[-nx:] += lin.end[0]
        b, low = lin.x_next.value.copy(), -rows.value
        b[0] += lin.x_next.by_x[0] @ dx0
        low[0] -= rows.by_x[0] @ dx0
        x_l, x_u = np.full((N, each), -np.inf), np.full((N, each), np.inf)
        x_l[:, nu] = 0.0
        x_l[:, :nu], x_u[:, :nu] = bounds
        matrices = (sp.csc_matrix(matrix) for matrix in (P, A, G))
        P_, A_, G_ = matrices
        return cls(P_, c, A_, b.ravel(), G_, low.ravel(), x_l.ravel(), x_u.ravel())


@dataclass(frozen=True)
class Captured:
    """The first program of one sample of a closed loop: assembled, and as its controller solves it."""

    program: Program
    qp: HorizonQP
    arguments: tuple[Any, ...]

    def solution(self) -> np.ndarray:
        """Return the inputs du by the controller's method."""
        found = self.qp.solve(*self.arguments, (Tolerance(1e-8, 1e-8), MAX_QP_ITERATIONS))
        if not found.solved:
            raise RuntimeError("not solved")
        return found.du.ravel()

    def inputs(self, z: np.ndarray) -> np.ndarray:
        """Return the inputs du among the variables of the assembled program."""
        N, nu = self.arguments[3][0].shape
        return z.reshape(N, -1)[:, :nu].ravel()


def captured(name: str, N: int) -> Captured:
    """Return the first program of one sample of a closed loop."""
    controller = Controller(problems.get(name, N=N), phase="qp")
    controller._phase.compiled = None
    phase, seen = controller._phase, []
    qp = phase.qp = compiled_qp(controller.model, phase.n_rows)
    solve = qp.solve

    def keep(*arguments: Any, **separate: bool) -> Any:
        seen.append(arguments[:5])
        return solve(*arguments, **separate)

    plant, x = Plant(controller.problem, "exact", {}), controller.start
    for k in range(SAMPLE + 1):
        if k == SAMPLE:
            qp.solve = keep
        x = plant.step(x, controller.step(x).u)[0]
    del qp.solve
    return Captured(Program.of(*seen[0]), qp, seen[0])


Solve = Callable[[], np.ndarray]


def by_piqp(program: Program, kind: Any, tolerance: float = 1e-9, gap: bool = False) -> Solve:
    """Return a solve by PIQP, dense if ``kind`` is None; the pattern is set up once, ``gap`` asks for a small one."""
    given = (
        program.P,
        program.c,
        program.A,
        program.b,
        program.G,
        program.low,
        np.full(program.low.size, np.inf),
        program.x_l,
        program.x_u,
    )
    dense = kind is None
    if dense:
        given = tuple(v.toarray() if sp.issparse(v) else v for v in given)
    solver = piqp.DenseSolver() if dense else piqp.SparseSolver()
    settings = solver.settings
    if not dense:
        settings.kkt_solver = kind
    settings.check_duality_gap = gap
    settings.eps_abs, settings.eps_rel = tolerance, 0.0
    settings.eps_duality_gap_abs, settings.eps_duality_gap_rel = tolerance, 0.0
    solver.setup(*given)

    def solve() -> np.ndarray:
        solver.update(*given)
        if solver.solve() != piqp.PIQP_SOLVED:
            raise RuntimeError(str(solver.result.info.status))
        return np.array(solver.result.x)

    return solve


def by_casadi(program: Program, plugin: str) -> Solve:
    """Return a solve by a plugin of ``casadi.conic``."""
    options = {**PLUGINS[plugin], "print_time": False, "error_on_fail": True}
    H, A = ca.DM(program.P), ca.DM(sp.vstack([program.A, program.G]).tocsc())
    solver = ca.conic("solver", plugin, {"h": H.sparsity(), "a": A.sparsity()}, options)
    given = {
        "h": H,
        "g": program.c,
        "a": A,
        "lbx": program.x_l,
        "ubx": program.x_u,
        "lba": np.concatenate([program.b, program.low]),
        "uba": np.concatenate([program.b, np.full(program.low.size, np.inf)]),
    }
    return lambda: np.array(solver(**given)["x"]).ravel()


def by_hpipm(case: Captured) -> Solve:
    """Return a solve by HPIPM through CasADi, which takes the rows of each step after its equations."""
    program, (N, nx), nu = case.program, case.arguments[0].x_next.value.shape, case.arguments[3][0].shape[1]
    m = program.low.size // N
    order = np.concatenate([np.r_[k * nx : (k + 1) * nx, N * nx + k * m : N * nx + (k + 1) * m] for k in range(N)])
    H, A = ca.DM(program.P), ca.DM(sp.vstack([-program.A, program.G]).tocsr()[order].tocsc())
    sizes = {"N": N, "nx": [0] + [nx] * N, "nu": [nu + 1] * N + [0], "ng": [m] * N + [0]}
    options = {**sizes, "print_time": False, "error_on_fail": True}
    solver = ca.conic("solver", "hpipm", {"h": H.sparsity(), "a": A.sparsity()}, options)
    given = {
        **{"h": H, "g": program.c, "a": A, "lbx": program.x_l, "ubx": program.x_u},
        "lba": np.concatenate([-program.b, program.low])[order],
        "uba": np.concatenate([-program.b, np.full(program.low.size, np.inf)])[order],
    }
    return lambda: np.array(solver(**given)["x"]).ravel()


def timed(solve: Solve, of: Callable[[np.ndarray], np.ndarray], best: np.ndarray) -> str:
    """Return the median milliseconds of a solve, with its inputs' distance from the ``best`` if large."""
    x, seconds = of(solve()), []
    for _ in range(ROUNDS):
        began = time.perf_counter()
        x = of(solve())
        seconds.append(time.perf_counter() - began)
        if sum(seconds) > LIMIT:
            break
    off = float(np.abs(x - best).max() / max(1.0, np.abs(best).max()))
    return f"{1e3 * median(seconds):.3g}" + (f" (off {off:.0e})" if off > SAME else "")


def main() -> None:
    """Measure all, print the table, and store it."""
    stages, ldlt = piqp.KKTSolver.sparse_multistage, piqp.KKTSolver.sparse_ldlt
    ways: dict[str, Callable[[Captured], Solve]] = {
        "ours": lambda case: case.solution,
        "PIQP stages": lambda case: by_piqp(case.program, stages),
        "PIQP sparse LDLT": lambda case: by_piqp(case.program, ldlt),
        "PIQP dense": lambda case: by_piqp(case.program, None),
    }
    for plugin in filter(ca.has_conic, PLUGINS):
        ways[f"CasADi {plugin}"] = lambda case, plugin=plugin: by_casadi(case.program, plugin)
    if ca.has_conic("hpipm"):
        ways["CasADi hpipm"] = by_hpipm
    given = {f"{name} {N}": captured(name, N) for name, N in CASES}
    best = {label: case.inputs(by_piqp(case.program, ldlt, 1e-11, True)()) for label, case in given.items()}
    rows = []
    for way, make in ways.items():
        cells = []
        for label, case in given.items():
            try:
                cells.append(timed(make(case), (lambda z: z) if way == "ours" else case.inputs, best[label]))
            except (RuntimeError, ValueError) as error:
                print(f"{way}, {label}: {' '.join(str(error).split())[-160:]}")
                cells.append("failed")
        rows.append([way, *cells])
        print(way, *cells, flush=True)
    columns = ["solver", *given]
    print(table(columns, rows))
    write_table(
        "mpc-programs",
        title="Quadratic programs of a sample [ms]",
        command="make bench-mpc",
        columns=columns,
        rows=rows,
    )


if __name__ == "__main__":
    main()
